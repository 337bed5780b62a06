"""Many runs at once: their jobs, how they fared, and what they say together."""

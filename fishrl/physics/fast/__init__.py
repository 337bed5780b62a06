"""The fast solver: flows advanced in place by a compiled step."""

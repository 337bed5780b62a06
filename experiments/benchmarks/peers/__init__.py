"""Other codes, timed beside this one; each is left out with a word where it is not installed."""

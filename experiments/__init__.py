"""Programs: train a fish, evaluate it, draw what it does. Nothing imports this package."""

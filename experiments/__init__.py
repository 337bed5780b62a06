"""Programs: train a policy, evaluate it, draw its episodes. Nothing imports this package."""

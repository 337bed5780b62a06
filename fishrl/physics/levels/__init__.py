"""Levels: finer grids inside a coarse one, which follow bodies. ``step.py`` has the steps."""

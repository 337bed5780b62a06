"""Lateral-line classifiers: signals of real flows, fits to them, and their accuracy."""

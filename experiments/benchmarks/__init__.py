"""Measurements of the benchmark, one file per group; ``contest.py`` is the protocol."""

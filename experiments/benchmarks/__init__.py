"""What the benchmark measures, a file per group, and how: ``contest.py`` is the protocol."""

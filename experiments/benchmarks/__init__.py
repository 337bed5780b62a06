"""The benchmark: the measuring loop, its cases, report."""

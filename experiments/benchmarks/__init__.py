"""The benchmark: the measuring loop, cases of fishrl and of other codes, report."""

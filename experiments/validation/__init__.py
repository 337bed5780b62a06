"""Flows that others have solved, run here and judged by their numbers."""

"""Sweeps: jobs, status of runs, and statistics over seeds."""

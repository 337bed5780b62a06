"""Benchmarks of solver, environment and training."""

"""Training: the loop, its algorithms, checkpoints and evaluation."""

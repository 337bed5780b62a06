"""Watch trained policies swim: ``python -m fishrl.demo``."""

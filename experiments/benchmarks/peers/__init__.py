"""Other codes to compare with; those that are not installed are skipped and listed."""

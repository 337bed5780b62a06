"""Research programs: reproduction, validation, benchmarks, gaits. Nothing imports them."""

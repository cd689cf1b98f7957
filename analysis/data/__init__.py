"""Results as pandas frames: results roots, published tables, curricula of runs."""

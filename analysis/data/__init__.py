"""Results as frames: of roots, published tables and single curricula."""

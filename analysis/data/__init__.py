"""Results as frames, from roots, published tables and single curricula."""

"""Results as frames: of roots, of published tables, and of single curricula."""

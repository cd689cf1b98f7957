"""Self-contained interactive pages."""

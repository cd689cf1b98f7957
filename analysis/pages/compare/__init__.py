"""The page that sets one's own results beside released ones."""

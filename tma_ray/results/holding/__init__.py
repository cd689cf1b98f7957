"""Who holds a results root, and its signs of life."""

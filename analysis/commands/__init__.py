"""Views of results that commands print or write to files."""

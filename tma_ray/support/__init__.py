"""General-purpose tools used by all other packages."""

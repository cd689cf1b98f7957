"""General-purpose tools used on every floor."""

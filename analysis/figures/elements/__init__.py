"""Elements that several figures have in common."""

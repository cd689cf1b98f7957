"""Components that users select by name: registry, settings and plug-in source."""

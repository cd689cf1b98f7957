"""Components that users name: registry, settings and plug-in source."""

"""Viewing of policies: rendered episodes, and the playground in a browser."""

"""Rendered episodes of policies, and the playground in a browser."""

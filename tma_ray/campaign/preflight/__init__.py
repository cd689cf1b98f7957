"""Checks before the first run: addresses, storage, plug-ins and environments on every node."""

"""Errors that say why something of the original release is not imported."""

from __future__ import annotations


class ImportRefusedError(ValueError):
    """Nothing was imported; the message says why and what to do."""


class DamagedSeedError(ValueError):
    """One seed is left out; the message names the file, what is wrong with it and what to do."""


class RefusedPickleError(DamagedSeedError):
    """A pickle that asks for more than arrays and containers, or is cut off; nothing of it was run."""

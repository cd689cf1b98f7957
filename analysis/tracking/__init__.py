"""Scalars of runs for TensorBoard and Weights & Biases, from published rows only."""

from analysis.tracking.folder import EventFolder
from analysis.tracking.points import watch

__all__ = ["EventFolder", "watch"]

"""Scalars of runs for TensorBoard and Weights & Biases, from published rows only."""

from analysis.tracking.event_folder import EventFolder
from analysis.tracking.points import watch

__all__ = ["EventFolder", "watch"]

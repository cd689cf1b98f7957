"""Scalars of runs for TensorBoard and Weights & Biases, taken only from published rows."""

from analysis.tracking.event_folder import EventFolder
from analysis.tracking.points import watch

__all__ = ["EventFolder", "watch"]

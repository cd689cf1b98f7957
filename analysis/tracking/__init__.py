"""Export of the published scalars of runs to TensorBoard and Weights & Biases."""

from analysis.tracking.event_folder import EventFolder
from analysis.tracking.points import watch

__all__ = ["EventFolder", "watch"]

"""Event files for TensorBoard, written from result tables."""

from analysis.tensorboard.folder import EventFolder, watch

__all__ = ["EventFolder", "watch"]

"""Figures: one function each, data in, matplotlib figure out."""

from analysis.figures.axes import share_step_label, step_axis
from analysis.figures.final_bars import final_bars
from analysis.figures.learning_curve import learning_curve
from analysis.figures.mastery import mastery_map

__all__ = ["final_bars", "learning_curve", "mastery_map", "share_step_label", "step_axis"]

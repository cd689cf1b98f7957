"""Figures: one function each, data in, matplotlib figure out. `analysis.style.save` writes them."""

from analysis.figures.axes import share_step_label, step_axis
from analysis.figures.bars import Whisker, bars_with_pairs
from analysis.figures.curves import CurvePanel, curves_with_stars
from analysis.figures.film import animation, projected
from analysis.figures.final_bars import final_bars
from analysis.figures.learning_curve import learning_curve
from analysis.figures.mastery import mastery_map
from analysis.figures.pairs import pairwise_curves
from analysis.figures.panels import body_panels, knowledge_panels
from analysis.figures.radar import radar
from analysis.teacher_view import Shot, film_strip

__all__ = [
    "CurvePanel",
    "Shot",
    "Whisker",
    "animation",
    "bars_with_pairs",
    "body_panels",
    "curves_with_stars",
    "film_strip",
    "final_bars",
    "knowledge_panels",
    "learning_curve",
    "mastery_map",
    "pairwise_curves",
    "projected",
    "radar",
    "share_step_label",
    "step_axis",
]

"""Figures: one function each, data in, matplotlib figure out. `analysis.figures.style.save` writes them."""

from analysis.figures.bars.drawing import Whisker, bars_with_pairs
from analysis.figures.curricula.film_strips import Shot, film_strip
from analysis.figures.curricula.motion import animation, projected
from analysis.figures.curves.pairs import pairwise_curves
from analysis.figures.curves.panels import body_panels, knowledge_panels
from analysis.figures.curves.stars import CurvePanel, curves_with_stars
from analysis.figures.elements.axes import share_step_label, step_axis
from analysis.figures.mastery import mastery_map
from analysis.figures.radars.chart import radar
from analysis.figures.seeds import final_bars, learning_curve

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

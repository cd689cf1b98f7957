"""Figures: one function each, data in, matplotlib figure out. `analysis.figures.style.save` writes them."""

from analysis.figures.bars import Whisker, bars_with_pairs
from analysis.figures.curricula import Shot, animation, film_strip, projected
from analysis.figures.curves import (
    CurvePanel,
    body_panels,
    curves_with_stars,
    knowledge_panels,
    pairwise_curves,
)
from analysis.figures.elements import share_step_label, step_axis
from analysis.figures.radars import radar
from analysis.figures.seeds import final_bars, learning_curve, mastery_map

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

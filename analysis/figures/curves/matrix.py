"""Differences of every pair of many teachers at their last step, as a matrix."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from analysis.figures.style import TWO_COLUMNS
from analysis.formatting import amount
from analysis.names import short_labels

COLOURS = "RdBu"
"""From red for below to blue for above; readable with any colour vision."""


def difference_matrix(table: pd.DataFrame, tests: pd.DataFrame, teachers: Sequence[str], name: str) -> Figure:
    """Draws the difference of each row's teacher to each column's, with a dot where it is significant.

    Args:
        table: teacher, step and mean.
        tests: significant ones at every step: first, second and step.
        teachers: rows and columns.
        name: what is measured, with its unit.
    """
    last = table["step"].max()
    means = table[table["step"] == last].set_index("teacher")["mean"].reindex(teachers).to_numpy(float)
    differences = means[:, None] - means[None, :]
    reach = max(float(np.nanmax(np.abs(differences))), 1.0)
    side = min(TWO_COLUMNS + 0.6, 1.9 + 0.17 * len(teachers))
    figure = Figure(figsize=(side + 0.6, side), layout="constrained")
    axes = figure.subplots()
    mesh = axes.imshow(differences, cmap=COLOURS, vmin=-reach, vmax=reach)
    places = {teacher: place for place, teacher in enumerate(teachers)}
    found = tests[tests["step"] == last]
    for first, second in zip(found["first"], found["second"], strict=True):
        ends = places[first], places[second]
        axes.plot(ends, ends[::-1], linestyle="none", marker="o", markersize=2, color="black")
    names = [short_labels(teachers, 18)[teacher] for teacher in teachers]
    axes.set_xticks(range(len(teachers)), names, rotation=90, fontsize=5.5)
    axes.set_yticks(range(len(teachers)), names, fontsize=5.5)
    axes.set_title(f"Row minus column after {amount(last)} steps; dots: p < 0.05 after Holm", fontsize=7)
    bar = figure.colorbar(mesh, ax=axes, fraction=0.04, pad=0.02)
    bar.set_label(f"Difference: {name[:1].lower()}{name[1:]}", fontsize=7)
    bar.outline.set_visible(False)
    return figure

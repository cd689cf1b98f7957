"""Panels that show a plane of the task space."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.data.task_axes import Axis
from analysis.looks import MUTED


def label_plane(figure: Figure, axes: Axes, plane: tuple[Axis, Axis]) -> None:
    """Names the axes that all panels of `figure` share, and gives them the task space's bounds."""
    axes.set_xlim(plane[0].low, plane[0].high)
    axes.set_ylim(plane[1].low, plane[1].high)
    figure.supxlabel(plane[0].name, fontsize=8.5)
    figure.supylabel(plane[1].name, fontsize=8.5)


def frame(axes: Axes) -> None:
    """Draws a light frame around a small panel."""
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color("#b9bec6")
    axes.tick_params(length=2)


def remark(axes: Axes, text: str) -> None:
    """Says in the middle of an empty panel why it is empty."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=MUTED)

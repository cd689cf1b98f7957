"""Look of a line that is one teacher at one level of expert knowledge."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from matplotlib.colors import to_hex, to_rgb
from matplotlib.lines import Line2D

from analysis.figures.elements.legends import teacher_handle
from analysis.looks import Look, look
from analysis.names import order, short_labels, teacher_order, title
from tma_ray.tasks import KnowledgeLevel

Line = tuple[str, str]
"""A teacher and a level of expert knowledge."""

_DASHES: dict[str, str | tuple[int, tuple[int, ...]]] = {
    KnowledgeLevel.NONE.value: (0, (1, 1)),
    KnowledgeLevel.LOW.value: (0, (4, 2)),
    KnowledgeLevel.HIGH.value: "-",
}
_PALE = {KnowledgeLevel.NONE.value: 1.0, KnowledgeLevel.LOW.value: 0.6, KnowledgeLevel.HIGH.value: 0.0}


def line_order(line: Line) -> tuple[tuple[bool, bool, str], tuple[int, str]]:
    """Sorts lines by teacher, then by level."""
    return teacher_order(line[0]), order("expert_knowledge", line[1])


class LineLooks:
    """How the lines of one figure are told apart: by teacher, and by level where there are several."""

    def __init__(self, lines: Iterable[Line]) -> None:
        self.lines = sorted(set(lines), key=line_order)
        self._names = short_labels(teacher for teacher, _ in self.lines)
        self._several_teachers = len(self._names) > 1
        self._several_levels = len({level for _, level in self.lines}) > 1

    def name(self, line: Line) -> str:
        """Returns what the legend calls a line."""
        teacher, level = line
        if not self._several_levels:
            return self._names[teacher]
        told = title("expert_knowledge", level)
        return f"{self._names[teacher]}, {told.lower()}" if self._several_teachers else told

    def look(self, line: Line) -> Look:
        """Returns colour, marker and dashes of a line."""
        style = look(line[0])
        return style._replace(dashes=_DASHES.get(line[1], "-")) if self._several_levels else style

    def fill(self, line: Line) -> str:
        """Returns the colour inside its markers, paler for less knowledge."""
        pale = _PALE.get(line[1], 0.0) if self._several_levels else 0.0
        red, green, blue = (part + (1 - part) * pale for part in to_rgb(look(line[0]).colour))
        return to_hex((red, green, blue))

    def handle(self, line: Line) -> Line2D:
        """Returns a piece of the line for a legend."""
        style = self.look(line)
        changes: dict[str, Any] = {"markerfacecolor": self.fill(line), "markeredgecolor": style.colour}
        return teacher_handle(line[0], self.name(line), linestyle=style.dashes, **changes)

"""Draw the packages ("rooms") of the code, their layers ("floors") and imports: ``docs/images/rooms.svg``."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from html import escape
from itertools import accumulate, pairwise
from pathlib import Path
from statistics import fmean
from typing import Final

import numpy as np
from scipy.optimize import isotonic_regression

HOUSE: Final = Path(__file__).parents[2]

PICTURE: Final = HOUSE / "docs" / "images" / "rooms.svg"

WIDTH, HEIGHT, STEP = 800, 30, 74
"""Width of a floor, height of a room, and distance between floors, in pixels."""

LETTER, MARGIN, LANE, GAP = 7.6, 20, 8, 22
"""Width of a letter, space around the name of a room, width of a passing arrow and distance, in pixels."""

SWEEPS: Final = 24
"""Number of passes that order the rooms of all floors by their neighbours."""

Edge = tuple[str, str]


def floors() -> list[list[str]]:
    """Return the rooms of each floor from top to bottom, from the first contract of import-linter."""
    contracts = tomllib.loads((HOUSE / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    return [[room.strip() for room in layer.split("|")] for layer in contracts[0]["layers"]]


def _imported(path: Path) -> Iterator[str]:
    """Yield the names of all modules that a file imports."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def imports(rooms: Iterable[str]) -> dict[str, set[str]]:
    """Return the rooms that each room imports, except itself."""
    rooms = sorted(rooms)
    imported = {}
    for room in rooms:
        path = HOUSE / Path(*room.split("."))
        files = path.rglob("*.py") if path.is_dir() else [path.with_suffix(".py")]
        names = {
            ".".join(name.split(".")[:depth])
            for file in files
            for name in _imported(file)
            for depth in (1, 2)
        }
        imported[room] = names.intersection(rooms) - {room}
    return imported


def without_detours(graph: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Return the transitive reduction of a graph."""

    def reached(room: str) -> set[str]:
        return graph[room].union(*(reached(target) for target in graph[room]))

    return {room: targets - set().union(*map(reached, targets)) for room, targets in graph.items()}


def _lanes(rows: list[list[str]], graph: Mapping[str, set[str]]) -> tuple[list[list[str]], list[list[str]]]:
    """Return the floors with a dummy node for every arrow that passes one, and the nodes of every arrow."""
    level = {room: number for number, row in enumerate(rows) for room in row}
    rows = [list(row) for row in rows]
    paths = []
    for room, targets in graph.items():
        for target in sorted(targets):
            lanes = [f"{room}>{target}@{number}" for number in range(level[room] + 1, level[target])]
            for lane in lanes:
                rows[int(lane.partition("@")[2])].append(lane)
            paths.append([room, *lanes, target])
    return rows, paths


def _width(node: str) -> float:
    return LANE if "@" in node else LETTER * len(node.removeprefix("tma_ray.")) + MARGIN


def _columns(row: list[str]) -> dict[str, float]:
    """Return the centres of the nodes of a floor with equal gaps, in pixels."""
    gap = (WIDTH - sum(map(_width, row))) / (len(row) + 1)
    centres, left = {}, gap
    for node in row:
        centres[node] = left + _width(node) / 2
        left += _width(node) + gap
    return centres


def ordered(rows: list[list[str]], edges: Iterable[Edge]) -> list[list[str]]:
    """Return the floors, with rooms ordered by the mean position of their neighbours, for few crossings."""
    neighbours: dict[str, list[str]] = {node: [] for row in rows for node in row}
    for upper, lower in edges:
        neighbours[upper].append(lower)
        neighbours[lower].append(upper)
    level = {node: number for number, row in enumerate(rows) for node in row}
    rows = [list(row) for row in rows]
    for sweep in range(SWEEPS):
        side = -1 if sweep % 2 else 1
        for number in range(len(rows))[::-side]:
            centres = {node: column for row in rows for node, column in _columns(row).items()}
            pulls = {
                node: [centres[other] for other in neighbours[node] if (level[other] - number) * side > 0]
                for node in rows[number]
            }
            rows[number].sort(key=lambda node: fmean(pulls[node] or [centres[node]]))
    return rows


def straightened(rows: list[list[str]], edges: Iterable[Edge]) -> dict[str, float]:
    """Return the centres of all nodes, in pixels, as near to the mean of their neighbours as possible."""
    centres = {node: column for row in rows for node, column in _columns(row).items()}
    neighbours: dict[str, list[str]] = {node: [] for row in rows for node in row}
    for edge in edges:
        for node, other in (edge, edge[::-1]):
            neighbours[node].append(other)
    for _ in range(SWEEPS):
        for row in rows:
            desired = [fmean(centres[other] for other in neighbours[node]) for node in row]
            gaps = ((_width(left) + _width(right)) / 2 + GAP for left, right in pairwise(row))
            offsets = np.array(list(accumulate(gaps, initial=0)))
            spread = isotonic_regression(desired - offsets).x + offsets  # keeps the order and minimum gaps
            centres |= dict(zip(row, map(float, spread), strict=True))
    return centres


def picture() -> str:
    """Return the drawing as SVG."""
    names = floors()
    rows, paths = _lanes(names, without_detours(imports(room for row in names for room in row)))
    edges = [edge for path in paths for edge in pairwise(path)]
    rows = ordered(rows, edges)
    columns = straightened(rows, edges)
    centres = {node: (columns[node], level * STEP) for level, row in enumerate(rows) for node in row}
    lines = []
    for upper, lower in edges:
        (x, y), (end, bottom) = centres[upper], centres[lower]
        y += HEIGHT
        bottom += HEIGHT if "@" in lower else 0
        head = "" if "@" in lower else ' marker-end="url(#head)"'
        middle = (y + min(bottom, y + STEP - HEIGHT)) / 2
        down = f" V{bottom:g}" if "@" in lower else ""
        lines.append(
            f'<path d="M{x:.1f} {y:g}C{x:.1f} {middle:g} {end:.1f} {middle:g} {end:.1f} '
            f'{y + STEP - HEIGHT - (0 if down else 5):g}{down}"{head}/>'
        )
    boxes = [
        f'<rect x="{x - _width(room) / 2:.1f}" y="{y}" width="{_width(room):.1f}" height="{HEIGHT}" rx="4"/>'
        f'<text x="{x:.1f}" y="{y + 20}">{escape(room.removeprefix("tma_ray."))}</text>'
        for room, (x, y) in centres.items()
        if "@" not in room
    ]
    left = min(x - _width(node) / 2 for node, (x, _) in centres.items())
    width = max(x + _width(node) / 2 for node, (x, _) in centres.items()) - left
    height = (len(rows) - 1) * STEP + HEIGHT
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" '
        f'viewBox="{left - 1:.1f} -1 {width + 2:.1f} {height + 2}" font-family="sans-serif" font-size="14" '
        'text-anchor="middle">\n'
        '<defs><marker id="head" viewBox="0 0 8 8" refX="3" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto"><path d="M0 0L8 4L0 8z" fill="#7986cb"/></marker></defs>\n'
        f'<g fill="none" stroke="#7986cb" stroke-width="1.2">\n{chr(10).join(lines)}\n</g>\n'
        f'<g fill="#eef1f8" stroke="#3f51b5">\n{chr(10).join(boxes)}\n</g>\n</svg>\n'
    ).replace("<text ", '<text fill="#22262b" stroke="none" ')


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")

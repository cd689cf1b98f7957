"""Radar charts: each teacher's results on all challenges as ratios of Random's."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.projections.polar import PolarAxes
from numpy.typing import NDArray

from analysis.data.reference import BASELINE, is_baseline
from analysis.figures.elements import (
    legend,
    legend_height,
    mark_handle,
    require,
    require_unique,
    significant,
    teacher_handles,
)
from analysis.figures.style import ONE_COLUMN, TWO_COLUMNS, styled
from analysis.formatting import number
from analysis.looks import INK, MUTED, RULE, look, shown_together
from analysis.names import label, teacher_order
from tma_ray.benchmark import ORIGINAL_SPACE, STUMP_TRACKS_CHALLENGES, Matrix, find_challenge
from tma_ray.tasks import KnowledgeLevel

RADIUS = 0.86
"""Of the chart, inches."""

LABEL = 6.8
"""Size of the letters, points."""

STAR_GAP = 0.092
"""From one star to the next, inches."""

STAR_COLUMNS = 4
"""Stars side by side at one axis; more of them stand in further rows."""

STAR_ROWS = 2
"""With more rows of stars than these, their number is written."""

BEYOND = 0.16
"""Width of the band outside of the rings, over the radius of the outermost ring."""


class Star(NamedTuple):
    """A significant result: whose, and on which axis."""

    teacher: str
    axis: int


class RadarAxes:
    """A radar chart in a figure that is laid out in inches."""

    def __init__(
        self,
        figure: Figure,
        centre: tuple[float, float],
        titles: Sequence[str],
        high: float,
        beyond: bool = False,
    ) -> None:
        """Draws axes and rings.

        Args:
            figure: where to.
            centre: from the lower left corner, inches.
            titles: names of the axes, clockwise from the top.
            high: largest finite value; the rim is the next half above it.
            beyond: whether there are infinite values, which lie in a band outside of the rim.
        """
        self._figure, self._centre, self._titles = figure, centre, titles
        self.rim = max(1.5, math.ceil(high / 0.5 + 0.02) * 0.5)
        self.angles = 2 * np.pi * np.arange(len(titles)) / len(titles)
        width, height = figure.get_size_inches()
        (x, y), side = centre, 2 * RADIUS
        box = ((x - RADIUS) / width, (y - RADIUS) / height, side / width, side / height)
        axes = figure.add_axes(box, projection="polar")
        assert isinstance(axes, PolarAxes)
        self.axes = axes
        axes.set_theta_zero_location("N")
        axes.set_theta_direction(-1)
        outer = self.rim * (1 + BEYOND) if beyond else self.rim
        axes.set_ylim(0, outer)
        axes.set_axis_off()
        for angle in self.angles:
            axes.plot([angle, angle], [0, outer], color=RULE, linewidth=0.6, zorder=0)
        step = 0.5 if self.rim <= 2 else 1.0
        for ring in (*np.arange(step, self.rim, step), self.rim):
            self._ring(float(ring), color=RULE, linewidth=0.6, zorder=0)
        for ring in np.arange(1, self.rim + 0.01):
            self._name_ring(float(ring), f"{ring:g}")
        if beyond:
            self._ring(outer, color=RULE, linewidth=0.6, linestyle=(0, (2, 2)), zorder=0, gid="beyond")
            self._name_ring(outer, "\N{INFINITY}")
        random = look("random")
        self._ring(1.0, color=random.colour, linestyle=random.dashes, linewidth=1.1, zorder=1, gid="random")
        for axis, title in enumerate(titles):
            self._name_axis(axis, title)

    def title(self, text: str) -> None:
        """Writes what the panel shows above it."""
        self._write(0, RADIUS + 0.58, text, fontsize=8, fontweight="bold", ha="center", va="bottom")

    def note(self, text: str) -> None:
        """Writes what is missing below the panel."""
        self._write(0, -RADIUS - 0.42, text, fontsize=6, color=MUTED, ha="center", va="top", linespacing=1.25)

    def radius(self, value: float, share: float = 1.0) -> float:
        """Returns where a value lies: an infinite one at a `share` of the band beyond the rim."""
        return self.rim * (1 + BEYOND * share) if math.isinf(value) else value

    def line(self, teacher: str, values: Sequence[float], filled: Sequence[bool]) -> None:
        """Draws one teacher: a line where two neighbours have values, a mark on each axis that has one.

        Args:
            teacher: gives colour and mark.
            values: one for each axis, NaN for none.
            filled: whether its mark is full, for each axis.
        """
        style = look(teacher)
        around = [*range(len(values)), 0]
        shown = np.array([values[axis] for axis in around])
        self.axes.plot(
            np.append(self.angles, 2 * np.pi),
            shown,
            color=style.colour,
            linestyle=style.dashes,
            linewidth=1.1,
            zorder=2,
            label=teacher,
        )
        for angle, value, full in zip(self.angles, values, filled, strict=True):
            if math.isfinite(value):
                self.axes.plot(
                    [angle],
                    [value],
                    color=style.colour,
                    marker=style.marker,
                    markersize=3.4,
                    markerfacecolor=style.colour if full else "white",
                    markeredgewidth=0.7,
                    zorder=3,
                    clip_on=False,
                )

    def upper(self, values: Sequence[float]) -> None:
        """Draws a plus on each axis that has an upper baseline."""
        shown = [
            (angle, value) for angle, value in zip(self.angles, values, strict=True) if math.isfinite(value)
        ]
        if shown:
            angles, heights = zip(*shown, strict=True)
            self.axes.plot(
                angles,
                heights,
                linestyle="none",
                marker="+",
                color=INK,
                markersize=6,
                markeredgewidth=1.2,
                zorder=4,
                gid="upper",
            )

    def doubts(self, places: Iterable[tuple[int, float]]) -> None:
        """Writes a dagger beside the mark at each axis and radius."""
        for axis, radius in places:
            self.axes.annotate(
                "\N{DAGGER}",
                (self.angles[axis], radius),
                xytext=(3, 2),
                textcoords="offset points",
                fontsize=LABEL,
                gid="doubt",
                zorder=5,
            )

    def stars(self, stars: Sequence[Star]) -> None:
        """Draws stars in short rows beside the name of their axis, in the order given."""
        for axis in range(len(self._titles)):
            mine = [star for star in stars if star.axis == axis]
            anchor, align, up = self._place(axis)
            height = anchor[1] + up * (0.07 + 0.118 * len(self._lines(self._titles[axis])))
            if len(mine) > STAR_COLUMNS * STAR_ROWS:
                text, va = f"\N{BLACK STAR} {len(mine)} teachers", "center"
                self._write(anchor[0], height, text, fontsize=LABEL - 0.8, ha=align, va=va)
                continue
            for place, star in enumerate(mine):
                row, column = divmod(place, STAR_COLUMNS)
                reach = STAR_GAP * (min(STAR_COLUMNS, len(mine) - row * STAR_COLUMNS) - 1)
                first = anchor[0] - reach * {"left": 0.0, "center": 0.5, "right": 1.0}[align]
                first += {"left": 0.04, "center": 0.0, "right": -0.04}[align]
                x, y = self._centre[0] + first + STAR_GAP * column, self._centre[1] + height
                self._figure.add_artist(self._star(x, y + up * row * STAR_GAP, look(star.teacher).colour))

    def _star(self, x: float, y: float, colour: str) -> Line2D:
        return Line2D(
            [x],
            [y],
            transform=self._figure.dpi_scale_trans,
            marker="*",
            markersize=6.2,
            color=colour,
            markeredgewidth=0,
            linestyle="none",
        )

    def _ring(self, radius: float, **style: Any) -> None:
        around: NDArray[np.float64] = np.append(self.angles, 2 * np.pi)
        self.axes.plot(around, np.full(len(around), radius), **style)

    def _name_ring(self, ring: float, text: str) -> None:
        self.axes.annotate(
            text,
            (0, ring),
            xytext=(-2, 0),
            textcoords="offset points",
            fontsize=5.5,
            color=MUTED,
            ha="right",
            va="center",
        )

    def _name_axis(self, axis: int, title: str) -> None:
        (x, y), align, up = self._place(axis)
        lines = "\n".join(self._lines(title))
        va = "bottom" if up > 0 else "top"
        self._write(x, y, lines, fontsize=LABEL, ha=align, va=va, linespacing=1.05)

    def _place(self, axis: int) -> tuple[tuple[float, float], str, int]:
        """Returns where the name of an axis is anchored, how it is aligned, and if it grows up or down."""
        angle = float(self.angles[axis])
        x, y = RADIUS * math.sin(angle), RADIUS * math.cos(angle)
        if abs(x) < 0.05 * RADIUS:
            return (0.0, y + math.copysign(0.06, y)), "center", 1 if y > 0 else -1
        if y > -0.05 * RADIUS:  # in the corner that the axes leave free
            side = math.copysign(RADIUS + 0.17, x)
            return (side, y + 0.16), "right" if x > 0 else "left", 1
        return (x, y - 0.06), "center", -1

    @staticmethod
    def _lines(title: str) -> list[str]:
        return textwrap.wrap(title, 11) or [title]

    def _write(self, x: float, y: float, text: str, **style: Any) -> None:
        """Writes at a distance from the centre, in inches."""
        self._figure.text(
            self._centre[0] + x, self._centre[1] + y, text, transform=self._figure.dpi_scale_trans, **style
        )


class Ratios(NamedTuple):
    """One level of expert knowledge.

    Attributes:
        ratios: by teacher, one for each axis; NaN where there is none; infinite where the teacher is over 0
            and Random is not, 1 where both are at 0.
        shares: of the infinite ones, by teacher and axis: the result over the best one of that axis.
        upper: best result on the original space, for each axis; NaN where it says nothing.
        stars: who is significantly better than Random, and where.
        differ: teachers and axes with a significant difference from Random, either way.
        missing: what is not drawn, in words.
    """

    ratios: dict[str, list[float]]
    shares: dict[tuple[str, int], float]
    upper: list[float]
    stars: list[Star]
    differ: set[tuple[str, int]]
    missing: list[str]


def ratios_of_random(
    means: Mapping[tuple[str, str], float],
    tests: pd.DataFrame,
    teachers: Sequence[str],
    challenges: Sequence[Matrix],
    original: Matrix,
) -> Ratios:
    """Returns what is drawn of one level.

    Args:
        means: by teacher and challenge.
        tests: significant ones of this level: challenge, first and difference from Random.
        teachers: all of the figure.
        challenges: axes.
        original: where the upper baseline comes from.
    """
    names = [matrix.challenge for matrix in challenges]
    random = {name: mean for (teacher, name), mean in means.items() if is_baseline(teacher)}
    lower = [random.get(name, math.nan) for name in names]
    best = max((mean for (_, name), mean in means.items() if name == original.challenge), default=math.nan)
    ratios = {
        teacher: [
            _ratio(means.get((teacher, name), math.nan), low) for name, low in zip(names, lower, strict=True)
        ]
        for teacher in teachers
        if any((teacher, name) in means for name in names)
    }
    gaps = {
        key: gap
        for key, gap in _gaps(tests, names).items()
        if key[0] in ratios and not math.isnan(ratios[key[0]][key[1]])
    }
    stars = [Star(*key) for key, gap in gaps.items() if gap > 0]
    best_of = {name: max(mean for (_, place), mean in means.items() if place == name) for _, name in means}
    return Ratios(
        ratios,
        {
            (teacher, axis): means[teacher, names[axis]] / best_of[names[axis]]
            for teacher, line in ratios.items()
            for axis, ratio in enumerate(line)
            if math.isinf(ratio)
        },
        [
            _ratio(best, low) if _same_students(matrix, original) else math.nan
            for matrix, low in zip(challenges, lower, strict=True)
        ],
        sorted(stars, key=lambda star: (star.axis, teacher_order(star.teacher))),
        set(gaps),
        [*_no_random(names, lower), *_random_at_0(names, lower, means), *_no_result(means, teachers, names)],
    )


def _gaps(tests: pd.DataFrame, names: list[str]) -> dict[tuple[str, int], float]:
    """Returns the tested differences from Random by teacher and axis."""
    columns = tests["challenge"], tests["first"], tests["difference"]
    return {
        (str(first), names.index(name)): float(difference)
        for name, first, difference in zip(*columns, strict=True)
        if name in names
    }


def _ratio(mean: float, lower: float) -> float:
    if lower == 0 and not math.isnan(mean):
        return math.inf if mean > 0 else 1.0
    return mean / lower if lower > 0 else math.nan


def _same_students(matrix: Matrix, original: Matrix) -> bool:
    return (matrix.embodiments, matrix.students) == (original.embodiments, original.students)


def _no_random(names: Sequence[str], lower: Sequence[float]) -> list[str]:
    """Returns in words on which challenges ratios are missing."""
    return [
        f"no ratio on {_words(name)}: {label('random')} has no result"
        for name, mean in zip(names, lower, strict=True)
        if math.isnan(mean)
    ]


def _random_at_0(
    names: Sequence[str], lower: Sequence[float], means: Mapping[tuple[str, str], float]
) -> Iterator[str]:
    """Yields in words what lies outside of the rings, with the best result there."""
    for name, random in zip(names, lower, strict=True):
        found = {teacher: mean for (teacher, place), mean in means.items() if place == name and mean > 0}
        if random == 0 and found:
            best = max(found, key=lambda teacher: found[teacher])
            yield (
                f"{_words(name)}: {label('random')} is at 0, and who is over 0 beyond the rings, best "
                f"{label(best)} with {number(found[best])}"
            )


def _no_result(
    means: Mapping[tuple[str, str], float], teachers: Sequence[str], names: Sequence[str]
) -> list[str]:
    """Returns in words who has no results, and where."""
    gaps: dict[str, list[str]] = {}
    for teacher in teachers:
        absent = [_words(name) for name in names if (teacher, name) not in means]
        if absent and not is_baseline(teacher):
            where = "" if len(absent) == len(names) else f" on {', '.join(absent)}"
            gaps.setdefault(where, []).append(label(teacher))
    return [f"no results of {', '.join(who)}{where}" for where, who in sorted(gaps.items())]


def _words(name: str) -> str:
    return name.replace("_", " ")


PANEL_HEIGHT, CENTRE = 3.08, 1.36
"""Height of a panel without notes, and of its centre above them, inches."""

TOGETHER = 8
"""Teachers beside Random in one panel; more of them are drawn in further rows of panels."""


@styled
def radar(
    table: pd.DataFrame,
    tests: pd.DataFrame,
    measure: str = "mastered_percent",
    challenges: Sequence[Matrix] = STUMP_TRACKS_CHALLENGES,
    original: Matrix = ORIGINAL_SPACE,
) -> Figure:
    """Draws results on challenges as ratios of Random's mean, one panel per level of expert knowledge.

    Stars at the end of an axis, in the teachers' colours and order, say who is significantly better than
    Random there; marks on lines are filled where a teacher differs from Random, either way. A plus is the
    best result on the original space at that level, as a ratio of Random on that challenge, where bodies
    and students are those of the original space. A line has a gap where the result or Random is missing.
    Where Random is at 0, results over 0 lie in a band outside of the rings, the best at its outer edge.

    Args:
        table: of `pooling.pooled` (after `pooling.reuse_random`, since Random needs no knowledge) or
            `published.paper_frame`; other environments and challenges are left out.
        tests: of `pairwise.pairwise` or `pairwise_statistics.pairwise_from_statistics` against "random".
        measure: what is drawn.
        challenges: axes, clockwise from the top; at least three.
        original: where the upper baseline comes from.

    Raises:
        ValueError: under three challenges, no results of any, or several of a teacher on one of them.
    """
    mean = f"{measure}_mean"
    if len(challenges) < 3:
        raise ValueError(f"radar of {len(challenges)} challenges: expected at least 3")
    require(table, ["environment", "challenge", "expert_knowledge", "teacher", mean], "results")
    environment, names = challenges[0].environment, [matrix.challenge for matrix in challenges]
    table = table[(table["environment"] == environment) & table[mean].notna()]
    results = table[table["challenge"].isin(names)]
    require(results, [], f"results on {', '.join(names)} of {environment}")
    table = table[table["challenge"].isin([*names, original.challenge])]
    require_unique(table, ["challenge", "expert_knowledge", "teacher"], "results")
    levels = [level.value for level in KnowledgeLevel if level.value in set(results["expert_knowledge"])]
    tests = significant(tests[(tests["environment"] == environment) & (tests["second"].map(is_baseline))])
    teachers = sorted(results["teacher"].unique(), key=teacher_order)
    panels, doubts = {}, {}
    for level in levels:
        here = table[table["expert_knowledge"] == level]
        places = zip(here["teacher"].astype(str), here["challenge"].astype(str), strict=True)
        means = dict(zip(places, here[mean].astype(float), strict=True))
        mine = tests[tests["expert_knowledge"] == level]
        doubts[level] = _doubts(here, names)
        panels[level] = ratios_of_random(means, mine, teachers, challenges, original)
    with shown_together(teachers):
        return _drawn(panels, doubts, teachers, [find_challenge(environment, name).title for name in names])


def _doubts(here: pd.DataFrame, names: Sequence[str]) -> set[tuple[str, int]]:
    """Returns teachers and axes of results that may be slips of who published them."""
    rows = (
        here[here["challenge"].isin(names) & here["doubt"].fillna("").ne("")] if "doubt" in here else here[:0]
    )
    return {(str(row["teacher"]), names.index(row["challenge"])) for _, row in rows.iterrows()}


def _drawn(
    panels: dict[str, Ratios],
    doubts: dict[str, set[tuple[str, int]]],
    teachers: Sequence[str],
    titles: Sequence[str],
) -> Figure:
    """Draws a row of panels, one for each level, for every `TOGETHER` teachers."""
    values = [value for panel in panels.values() for value in (*_values(panel), *panel.upper)]
    high = max(filter(math.isfinite, values), default=1.0)
    beyond = any(map(math.isinf, values))
    others = [teacher for teacher in teachers if not is_baseline(teacher)]
    groups = [others[start : start + TOGETHER] for start in range(0, len(others), TOGETHER)] or [[]]
    said = {
        level: [*panel.missing, *(["\N{DAGGER} doubtful result"] if doubts[level] else [])]
        for level, panel in panels.items()
    }
    notes = {level: textwrap.wrap("; ".join(texts), 42) for level, texts in said.items()}
    width = TWO_COLUMNS if len(panels) > 1 else ONE_COLUMN
    below = 0.11 * max(map(len, notes.values()))
    named = [teacher_handles([BASELINE, *group]) for group in groups]
    marks = _marks(
        any(math.isfinite(value) or math.isinf(value) for p in panels.values() for value in p.upper)
    )
    heights = [PANEL_HEIGHT + legend_height(handles, width, LABEL) for handles in named]
    marks_height = legend_height(marks, width, LABEL)
    figure = Figure(figsize=(width, below + marks_height + sum(heights)))
    total = figure.get_figheight()
    legend(figure, marks, "upper center", LABEL, bbox_to_anchor=(0.5, 1.0))
    top = total - marks_height
    for group, handles, height in zip(groups, named, heights, strict=True):
        legend(figure, handles, "upper center", LABEL, bbox_to_anchor=(0.5, top / total))
        top -= height
        for column, (level, panel) in enumerate(panels.items()):
            centre = (width * (column + 0.5) / len(panels), top + CENTRE)
            axes = RadarAxes(figure, centre, titles, high, beyond)
            axes.title(f"{'no' if level == KnowledgeLevel.NONE else level} expert knowledge".capitalize())
            _draw_panel(axes, panel, group)
            axes.doubts(_places_of(doubts[level], panel, axes, group))
            if group is groups[-1]:
                axes.note("\n".join(notes[level]))
    return figure


def _places_of(
    doubts: set[tuple[str, int]], panel: Ratios, axes: RadarAxes, group: Sequence[str]
) -> Iterator[tuple[int, float]]:
    """Yields axis and radius of the doubtful results of some teachers, and of Random."""
    for teacher, axis in sorted(doubts):
        if teacher in group or is_baseline(teacher):
            value = panel.ratios[teacher][axis]
            yield axis, axes.radius(value, panel.shares.get((teacher, axis), 1.0))


def _values(panel: Ratios) -> Iterator[float]:
    return (value for line in panel.ratios.values() for value in line)


def _draw_panel(axes: RadarAxes, panel: Ratios, group: Sequence[str]) -> None:
    for teacher, values in panel.ratios.items():
        if teacher not in group and not is_baseline(teacher):
            continue
        radii = [axes.radius(value, panel.shares.get((teacher, i), 1.0)) for i, value in enumerate(values)]
        filled = [is_baseline(teacher) or (teacher, i) in panel.differ for i in range(len(values))]
        axes.line(teacher, radii, filled)
    axes.upper([axes.radius(value) for value in panel.upper])
    axes.stars([star for star in panel.stars if star.teacher in group])


def _marks(with_upper: bool) -> list[Line2D]:
    """Returns what the marks mean, for a legend."""
    marks = [
        mark_handle("*", "better than Random (p < 0.05)", markersize=6),
        mark_handle("o", "differs from Random (= 1)", markersize=4),
        mark_handle("o", "does not", markersize=4, markerfacecolor="white"),
        mark_handle("+", "best on the original space", markersize=6),
    ]
    return marks if with_upper else marks[:-1]

"""Radar charts: each teacher's results on all challenges as ratios of Random's."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from analysis.charts.base import (
    ONE_COLUMN,
    TOGETHER,
    TWO_COLUMNS,
    Chart,
    Key,
    require,
    require_unique,
    significant,
)
from analysis.data.reference import BASELINE, is_baseline
from analysis.formatting import number
from analysis.looks import Look, look, shown_together
from analysis.names import label, short_labels, teacher_order, title
from tma_ray.benchmark import ORIGINAL_SPACE, STUMP_TRACKS_CHALLENGES, Matrix, find_challenge
from tma_ray.tasks import KnowledgeLevel

BEYOND = 0.16
"""Width of the band outside of the rings, over the radius of the outermost ring."""

HEIGHT = 3.08
"""Height of a radar with its titles on paper, without notes, inches."""


class Star(NamedTuple):
    """A significant result: a teacher better than Random, on one of the axes."""

    teacher: str
    axis: int


@dataclass(frozen=True, eq=False)
class Spoke:
    """A teacher's line around a radar.

    Attributes:
        teacher: its teacher.
        name: entry of the legend.
        look: colour, marker and dashes.
        radii: one for each axis; NaN where there is none.
        full: for each axis True if its mark is full, since the result differs from Random's.
    """

    teacher: str
    name: str
    look: Look
    radii: Sequence[float]
    full: Sequence[bool]


@dataclass(frozen=True, eq=False)
class Radar:
    """One radar of a chart.

    Attributes:
        title: heading.
        axes: titles of the axes, clockwise from the top.
        rim: radius of the outermost ring; rings are ratios of Random.
        beyond: True for a band outside of the rim, for results over 0 where Random is at 0.
        spokes: lines of teachers.
        upper: best result on the original space by axis; NaN where it says nothing.
        stars: significant results in the order of axes and teachers.
        doubts: axis and radius of doubtful results.
        note: text below it.
    """

    title: str
    axes: Sequence[str]
    rim: float
    beyond: bool
    spokes: Sequence[Spoke]
    upper: Sequence[float]
    stars: Sequence[Star]
    doubts: Sequence[tuple[int, float]]
    note: str


class Ratios(NamedTuple):
    """Results at one level of expert knowledge as ratios of Random's.

    Attributes:
        ratios: ratios by teacher, one for each axis; NaN where there is none; infinite where the teacher is
            over 0 and Random is not, 1 where both are at 0.
        shares: results over the best one of their axis where ratios are infinite, by teacher and axis.
        upper: best result on the original space, for each axis; NaN where it says nothing.
        stars: teachers and axes with a result significantly better than Random's.
        differ: teachers and axes with a significant difference from Random, either way.
        doubts: teachers and axes of results that may be slips of who published them.
        missing: sentences on results that are not drawn.
    """

    ratios: dict[str, list[float]]
    shares: dict[tuple[str, int], float]
    upper: list[float]
    stars: list[Star]
    differ: set[tuple[str, int]]
    doubts: set[tuple[str, int]]
    missing: list[str]

    def radius(self, teacher: str, axis: int, rim: float) -> float:
        """Return the radius of a ratio: an infinite one lies in the band beyond the rim."""
        ratio = self.ratios[teacher][axis]
        return rim * (1 + BEYOND * self.shares.get((teacher, axis), 1.0)) if math.isinf(ratio) else ratio


def radar(
    table: pd.DataFrame,
    tests: pd.DataFrame,
    measure: str = "mastered_percent",
    challenges: Sequence[Matrix] = STUMP_TRACKS_CHALLENGES,
    original: Matrix = ORIGINAL_SPACE,
) -> Chart:
    """Return results on challenges as ratios of Random's mean, one panel per level of expert knowledge.

    Stars at the end of an axis, in the teachers' colours and order, say who is significantly better than
    Random there; marks on lines are filled where a teacher differs from Random, either way. A plus is the
    best result on the original space at that level, as a ratio of Random on that challenge, where bodies
    and students are those of the original space. A line has a gap where the result or Random is missing.
    Where Random is at 0, results over 0 lie in a band outside of the rings, the best at its outer edge.

    Args:
        table: results of `pooling.pooled` (after `pooling.reuse_random`, since Random needs no knowledge) or
            `published.paper_frame`; other environments and challenges are left out.
        tests: tests of `frame.pairwise` or `frame.pairwise_from_statistics` against "random".
        measure: measure that is drawn.
        challenges: axes, clockwise from the top; at least three.
        original: matrix that the upper baseline comes from.

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
    tests = significant(tests[(tests["environment"] == environment) & (tests["second"].map(is_baseline))])
    teachers = sorted(results["teacher"].unique(), key=teacher_order)
    levels = {
        level.value: ratios_of_random(
            table[table["expert_knowledge"] == level.value],
            tests[tests["expert_knowledge"] == level.value],
            mean,
            teachers,
            challenges,
            original,
        )
        for level in KnowledgeLevel
        if level.value in set(results["expert_knowledge"])
    }
    with shown_together(teachers):
        return _chart(levels, teachers, [find_challenge(environment, name).title for name in names])


def ratios_of_random(
    table: pd.DataFrame,
    tests: pd.DataFrame,
    mean: str,
    teachers: Sequence[str],
    challenges: Sequence[Matrix],
    original: Matrix,
) -> Ratios:
    """Return the ratios at one level.

    Args:
        table: results of this level: teacher, challenge, perhaps doubt, and the column `mean`.
        tests: significant ones of this level: challenge, first and difference from Random.
        mean: column of `table`.
        teachers: all teachers of the figure.
        challenges: challenges of the axes.
        original: matrix that the upper baseline comes from.
    """
    names = [matrix.challenge for matrix in challenges]
    places = zip(table["teacher"].astype(str), table["challenge"].astype(str), strict=True)
    means = dict(zip(places, table[mean].astype(float), strict=True))
    random = {name: value for (teacher, name), value in means.items() if is_baseline(teacher)}
    lower = [random.get(name, math.nan) for name in names]
    best = max((value for (_, name), value in means.items() if name == original.challenge), default=math.nan)
    ratios = {
        teacher: [
            _ratio(means.get((teacher, name), math.nan), low) for name, low in zip(names, lower, strict=True)
        ]
        for teacher in teachers
        if any((teacher, name) in means for name in names)
    }
    gaps = {
        (str(first), names.index(name)): float(difference)
        for name, first, difference in tests[["challenge", "first", "difference"]].itertuples(index=False)
        if name in names
    }
    gaps = {k: gap for k, gap in gaps.items() if k[0] in ratios and not math.isnan(ratios[k[0]][k[1]])}
    best_of = {name: max(value for (_, place), value in means.items() if place == name) for _, name in means}
    doubtful = table[table["doubt"].fillna("").ne("")] if "doubt" in table else table[:0]
    same = (original.embodiments, original.students)
    return Ratios(
        ratios,
        shares={
            (teacher, axis): means[teacher, names[axis]] / best_of[names[axis]]
            for teacher, line in ratios.items()
            for axis, ratio in enumerate(line)
            if math.isinf(ratio)
        },
        upper=[
            _ratio(best, low) if (matrix.embodiments, matrix.students) == same else math.nan
            for matrix, low in zip(challenges, lower, strict=True)
        ],
        stars=sorted(
            (Star(*key) for key, gap in gaps.items() if gap > 0),
            key=lambda star: (star.axis, teacher_order(star.teacher)),
        ),
        differ=set(gaps),
        doubts={
            (str(teacher), names.index(name))
            for teacher, name in doubtful[["teacher", "challenge"]].itertuples(index=False)
            if name in names
        },
        missing=[*_random_missing(names, lower, means), *_no_result(means, teachers, names)],
    )


def _ratio(mean: float, lower: float) -> float:
    if lower == 0 and not math.isnan(mean):
        return math.inf if mean > 0 else 1.0
    return mean / lower if lower > 0 else math.nan


def _random_missing(
    names: Sequence[str], lower: Sequence[float], means: Mapping[tuple[str, str], float]
) -> Iterator[str]:
    """Yield sentences on challenges on which Random has no result or is at 0."""
    for name, random in zip(names, lower, strict=True):
        words = name.replace("_", " ")
        if math.isnan(random):
            yield f"no ratio on {words}: {label('random')} has no result"
        found = {teacher: mean for (teacher, place), mean in means.items() if place == name and mean > 0}
        if random == 0 and found:
            best = max(found, key=lambda teacher: found[teacher])
            yield (
                f"{words}: {label('random')} is at 0, and who is over 0 beyond the rings, best "
                f"{label(best)} with {number(found[best])}"
            )


def _no_result(
    means: Mapping[tuple[str, str], float], teachers: Sequence[str], names: Sequence[str]
) -> list[str]:
    """Return sentences on teachers without results, with the challenges."""
    gaps: dict[str, list[str]] = {}
    for teacher in teachers:
        absent = [name.replace("_", " ") for name in names if (teacher, name) not in means]
        if absent and not is_baseline(teacher):
            where = "" if len(absent) == len(names) else f" on {', '.join(absent)}"
            gaps.setdefault(where, []).append(label(teacher))
    return [f"no results of {', '.join(who)}{where}" for where, who in sorted(gaps.items())]


def _chart(levels: Mapping[str, Ratios], teachers: Sequence[str], titles: Sequence[str]) -> Chart:
    """Return a row of radars, one for each level, for every `TOGETHER` teachers."""
    values = [
        value for each in levels.values() for line in (*each.ratios.values(), each.upper) for value in line
    ]
    rim = max(1.5, math.ceil(max(filter(math.isfinite, values), default=1.0) / 0.5 + 0.02) * 0.5)
    beyond = any(map(math.isinf, values))
    others = [teacher for teacher in teachers if not is_baseline(teacher)]
    groups = [others[start : start + TOGETHER] for start in range(0, len(others), TOGETHER)] or [[]]
    notes = {
        level: textwrap.wrap(
            "; ".join([*each.missing, *(["\N{DAGGER} doubtful result"] if each.doubts else [])]), 42
        )
        for level, each in levels.items()
    }
    rows = [
        [
            _radar(level, each, group, titles, rim, beyond, notes[level] if group is groups[-1] else [])
            for level, each in levels.items()
        ]
        for group in groups
    ]
    keys = [
        Key("*", "better than Random (p < 0.05)", size=6),
        Key("o", "differs from Random (= 1)", size=4),
        Key("o", "does not", full=False, size=4),
    ]
    if not all(np.isnan(each.upper).all() for each in levels.values()):
        keys.append(Key("+", "best on the original space", size=6))
    size = (
        TWO_COLUMNS if len(levels) > 1 else ONE_COLUMN,
        HEIGHT * len(rows) + 0.11 * max(map(len, notes.values())),
    )
    return Chart("radar", rows, keys=keys, size=size, letters=6.8)


def _radar(
    level: str,
    each: Ratios,
    group: Sequence[str],
    titles: Sequence[str],
    rim: float,
    beyond: bool,
    note: Sequence[str],
) -> Radar:
    names = short_labels([BASELINE, *group])
    shown = [teacher for teacher in each.ratios if teacher in group or is_baseline(teacher)]
    places = range(len(titles))
    spokes = [
        Spoke(
            teacher,
            names.get(teacher, label(teacher)),
            look(teacher),
            [each.radius(teacher, axis, rim) for axis in places],
            [is_baseline(teacher) or (teacher, axis) in each.differ for axis in places],
        )
        for teacher in shown
    ]
    return Radar(
        title("expert_knowledge", level),
        titles,
        rim,
        beyond,
        spokes,
        [rim * (1 + BEYOND) if math.isinf(value) else value for value in each.upper],
        [star for star in each.stars if star.teacher in group],
        [(axis, each.radius(who, axis, rim)) for who, axis in sorted(each.doubts) if who in shown],
        "\n".join(note),
    )

"""Results on challenges as ratios of Random: what one panel of a radar chart shows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import pandas as pd

from analysis.data.reference import is_baseline
from analysis.figures.radars.radar_axes import Star
from analysis.formatting import number
from analysis.names import label, teacher_order
from tma_ray.benchmark import Matrix


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

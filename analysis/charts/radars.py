"""Radar charts: each teacher's results on all challenges as ratios of Random's."""

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from analysis.charts import base
from analysis.data.reference import BASELINE, is_baseline
from analysis.formatting import number
from analysis.names import label, short_labels, teacher_order, title
from tma_ray.benchmark import ORIGINAL_SPACE, STUMP_TRACKS_CHALLENGES, Matrix, find_challenge
from tma_ray.tasks import KnowledgeLevel

BEYOND = 0.16
"""Width of the band outside of the rings, over the radius of the outermost ring."""

HEIGHT = 3.08
"""Height of a radar with its titles on paper, without notes, inches."""


class Ratios(NamedTuple):
    """Results at one level of expert knowledge as ratios of Random's.

    Attributes:
        ratios: ratios by teacher, one for each axis; NaN where there is none; infinite where the teacher is
            over 0 and Random is not, 1 where both are at 0.
        shares: results over the best one of their axis where ratios are infinite, by teacher and axis.
        upper: best result on the original space, for each axis; NaN where it says nothing.
        differ: differences from Random that are significant, by teacher and axis.
        doubts: teachers and axes of results that may be slips of who published them.
        missing: sentences on results that are not drawn.
    """

    ratios: dict[str, list[float]]
    shares: dict[tuple[str, int], float]
    upper: list[float]
    differ: dict[tuple[str, int], float]
    doubts: set[tuple[str, int]]
    missing: list[str]


@dataclass(frozen=True, eq=False)
class Radar:
    """One radar of a chart.

    Attributes:
        title: heading.
        axes: titles of the axes, clockwise from the top.
        rim: radius of the outermost ring; rings are ratios of Random.
        beyond: True for a band outside of the rim, for results over 0 where Random is at 0.
        teachers: teachers that are drawn, and their entries of the legend.
        results: results of these and of other teachers.
        note: lines of text below it.
    """

    title: str
    axes: Sequence[str]
    rim: float
    beyond: bool
    teachers: Mapping[str, str]
    results: Ratios
    note: Sequence[str]

    def radius(self, teacher: str, axis: int) -> float:
        """Return the radius of a result: an infinite ratio lies in the band beyond the rim."""
        ratio = self.results.ratios[teacher][axis]
        share = self.results.shares.get((teacher, axis), 1.0)
        return self.rim * (1 + BEYOND * share) if math.isinf(ratio) else ratio


def radar(
    table: pd.DataFrame,
    tests: pd.DataFrame,
    measure: str = "mastered_percent",
    challenges: Sequence[Matrix] = STUMP_TRACKS_CHALLENGES,
    original: Matrix = ORIGINAL_SPACE,
) -> base.Chart:
    """Return results on challenges as ratios of Random's mean, one panel per level of expert knowledge.

    Stars at the end of an axis, in the teachers' colours and order, say who is significantly better than
    Random there; marks on lines are filled where a teacher differs from Random, either way. A plus is the
    best result on the original space at that level, as a ratio of Random on that challenge, where bodies
    and students are those of the original space. A line has a gap where the result or Random is missing.
    Where Random is at 0, results over 0 lie in a band outside of the rings, the best at its outer edge.

    Args:
        table: results of `pooling.pooled` (after `pooling.reuse_random`, since Random needs no knowledge) or
            `reference.paper_frame`; other environments and challenges are left out.
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
    base.require(table, ["environment", "challenge", "expert_knowledge", "teacher", mean], "results")
    environment, names = challenges[0].environment, [matrix.challenge for matrix in challenges]
    table = table[(table["environment"] == environment) & table[mean].notna()]
    results = table[table["challenge"].isin(names)]
    base.require(results, [], f"results on {', '.join(names)} of {environment}")
    table = table[table["challenge"].isin([*names, original.challenge])]
    base.require_unique(table, ["challenge", "expert_knowledge", "teacher"], "results")
    tests = base.significant(
        tests[(tests["environment"] == environment) & (tests["second"].map(is_baseline))]
    )
    teachers = sorted(results["teacher"].unique(), key=teacher_order)
    levels = {
        level.value: _ratios(
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
    values = np.concatenate(
        [line for each in levels.values() for line in (*each.ratios.values(), each.upper)]
    )
    rim = max(1.5, math.ceil(max(values[np.isfinite(values)], default=1.0) / 0.5 + 0.02) * 0.5)
    titles = [find_challenge(environment, name).title for name in names]
    others = [teacher for teacher in teachers if not is_baseline(teacher)]
    rows: list[list[Radar]] = []
    for start in range(0, max(len(others), 1), base.TOGETHER):
        labels = short_labels([BASELINE, *others[start : start + base.TOGETHER]])
        rows.append([])
        for level, each in levels.items():
            shown = {who: labels[who] for who in each.ratios if who in labels}
            notes = [*each.missing, *(["\N{DAGGER} doubtful result"] if each.doubts else [])]
            note = textwrap.wrap("; ".join(notes), 42) if start + base.TOGETHER >= len(others) else []
            heading, beyond = title("expert_knowledge", level), bool(np.isinf(values).any())
            rows[-1].append(Radar(heading, titles, rim, beyond, shown, each, note))
    keys = [
        base.Key("*", "better than Random (p < 0.05)", size=6),
        base.Key("o", "differs from Random (= 1)", size=4),
        base.Key("o", "does not", full=False, size=4),
    ]
    if not all(np.isnan(each.upper).all() for each in levels.values()):
        keys.append(base.Key("+", "best on the original space", size=6))
    width = base.TWO_COLUMNS if len(levels) > 1 else base.ONE_COLUMN
    height = HEIGHT * len(rows) + 0.11 * max(len(each.note) for each in rows[-1])
    return base.Chart("radar", rows, keys=keys, size=(width, height), letters=6.8)


def _ratios(
    table: pd.DataFrame,
    tests: pd.DataFrame,
    mean: str,
    teachers: Sequence[str],
    challenges: Sequence[Matrix],
    original: Matrix,
) -> Ratios:
    """Return the ratios at one level, of all results and of the tests against Random that are significant."""
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
    shares = {
        (teacher, axis): means[teacher, names[axis]] / best_of[names[axis]]
        for teacher, line in ratios.items()
        for axis, ratio in enumerate(line)
        if math.isinf(ratio)
    }
    upper = [
        _ratio(best, low) if (matrix.embodiments, matrix.students) == same else math.nan
        for matrix, low in zip(challenges, lower, strict=True)
    ]
    doubts = {
        (str(teacher), names.index(name))
        for teacher, name in doubtful[["teacher", "challenge"]].itertuples(index=False)
        if name in names
    }
    return Ratios(ratios, shares, upper, gaps, doubts, list(_missing(means, teachers, names, lower)))


def _ratio(mean: float, lower: float) -> float:
    if lower == 0 and not math.isnan(mean):
        return math.inf if mean > 0 else 1.0
    return mean / lower if lower > 0 else math.nan


def _missing(
    means: Mapping[tuple[str, str], float],
    teachers: Sequence[str],
    names: Sequence[str],
    lower: Sequence[float],
) -> Iterator[str]:
    """Yield sentences on results that are missing: of Random, over a Random of 0, of other teachers."""
    baseline = label(BASELINE)
    gaps: dict[str, list[str]] = {}
    for name, random in zip(names, lower, strict=True):
        words = name.replace("_", " ")
        found = {teacher: mean for (teacher, place), mean in means.items() if place == name and mean > 0}
        if math.isnan(random):
            yield f"no ratio on {words}: {baseline} has no result"
        if random == 0 and found:
            best = max(found, key=lambda teacher: found[teacher])
            yield (
                f"{words}: {baseline} is at 0, and who is over 0 beyond the rings, best "
                f"{label(best)} with {number(found[best])}"
            )
    for teacher in teachers:
        absent = [name.replace("_", " ") for name in names if (teacher, name) not in means]
        if absent and not is_baseline(teacher):
            where = "" if len(absent) == len(names) else f" on {', '.join(absent)}"
            gaps.setdefault(where, []).append(label(teacher))
    for where, who in sorted(gaps.items()):
        yield f"no results of {', '.join(who)}{where}"

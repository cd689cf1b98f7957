"""Radar charts of teachers' results on all challenges, as ratios to Random's results."""

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

BEYOND = 0.16  # width of the band outside the rings, as a share of the outermost ring's radius
HEIGHT = 3.08  # height of a radar in the paper figure, excluding the note lines below it, in inches


class Ratios(NamedTuple):
    """Results at one level of expert knowledge, as ratios to Random's results."""

    ratios: dict[str, list[float]]  # by teacher and axis; infinite if Random alone is at 0
    shares: dict[tuple[str, int], float]  # results as shares of the best, for infinite ratios
    upper: list[float]  # ratio of the original space's best result, by axis; NaN if not comparable
    differ: dict[tuple[str, int], float]  # significant differences from Random, by teacher and axis
    doubts: set[tuple[str, int]]  # teacher and axis of published results that are in doubt
    missing: list[str]  # sentences about results that are not drawn


@dataclass(frozen=True, eq=False)
class Radar:
    """One radar of a chart: the results at one level of expert knowledge."""

    title: str  # heading
    axes: Sequence[str]  # titles of the axes, clockwise from the top
    rim: float  # ratio to Random that the outermost ring stands for
    beyond: bool  # True to draw a band for infinite ratios outside the rim
    teachers: Mapping[str, str]  # legend entries by teacher, for the teachers that are drawn
    results: Ratios  # results, including those of teachers not drawn
    note: Sequence[str]  # lines of text below the radar

    def radius(self, teacher: str, axis: int) -> float:
        """Return the radius at which a result is drawn, beyond the rim for an infinite ratio."""
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
    """Return radar charts of results as ratios to Random's mean: an axis per challenge, a panel per level.

    Stars at the end of an axis mark teachers that are significantly better than Random; markers are filled
    where teachers differ from Random. A plus is the best result on the original space as a ratio to Random's
    on the challenge, if embodiments and students are the same. Missing ratios are gaps. Where Random is at 0,
    results above 0 lie in a band outside the rings, the best at its outer edge.

    Args:
        table: results from `pooling.pooled` after `pooling.reuse_random`, or `reference.paper_frame`.
        tests: tests from `pairwise.pairwise` or `pairwise.pairwise_from_statistics` against "random".
        measure: measure to draw.
        challenges: axes, clockwise from the top; at least three.
        original: matrix of the upper baseline.

    Raises:
        ValueError: if there are fewer than three challenges, no results, or several of a teacher on one.
    """
    mean = f"{measure}_mean"
    if len(challenges) < 3:
        raise ValueError(f"radar of {len(challenges)} challenges: expected at least 3")
    base.check_table(table, ["environment", "challenge", "expert_knowledge", "teacher", mean], "results")
    environment, names = challenges[0].environment, [matrix.challenge for matrix in challenges]
    table = table[(table["environment"] == environment) & table[mean].notna()]
    results = table[table["challenge"].isin(names)]
    base.check_table(results, [], f"results on {', '.join(names)} of {environment}")
    table = table[table["challenge"].isin([*names, original.challenge])]
    base.check_unique(table, ["challenge", "expert_knowledge", "teacher"], "results")
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
        [line for result in levels.values() for line in (*result.ratios.values(), result.upper)]
    )
    rim = max(1.5, math.ceil(max(values[np.isfinite(values)], default=1.0) / 0.5 + 0.02) * 0.5)
    titles = [find_challenge(environment, name).title for name in names]
    others = [teacher for teacher in teachers if not is_baseline(teacher)]
    rows: list[list[Radar]] = []
    for start in range(0, max(len(others), 1), base.TEACHERS_PER_PANEL):
        labels = short_labels([BASELINE, *others[start : start + base.TEACHERS_PER_PANEL]])
        rows.append([])
        for level, result in levels.items():
            shown = {teacher: labels[teacher] for teacher in result.ratios if teacher in labels}
            notes = [*result.missing, *(["\N{DAGGER} doubtful result"] if result.doubts else [])]
            last = start + base.TEACHERS_PER_PANEL >= len(others)
            note = textwrap.wrap("; ".join(notes), 42) if last else []
            heading, beyond = title("expert_knowledge", level), bool(np.isinf(values).any())
            rows[-1].append(Radar(heading, titles, rim, beyond, shown, result, note))
    keys = [
        base.LegendEntry("*", "better than Random (p < 0.05)", size=6),
        base.LegendEntry("o", "differs from Random (= 1)", size=4),
        base.LegendEntry("o", "does not", full=False, size=4),
    ]
    if not all(np.isnan(result.upper).all() for result in levels.values()):
        keys.append(base.LegendEntry("+", "best on the original space", size=6))
    width = base.TWO_COLUMNS if len(levels) > 1 else base.ONE_COLUMN
    height = HEIGHT * len(rows) + 0.11 * max(len(panel.note) for panel in rows[-1])
    return base.Chart("radar", rows, keys=keys, size=(width, height), letters=6.8)


def _ratios(
    table: pd.DataFrame,
    tests: pd.DataFrame,
    mean: str,
    teachers: Sequence[str],
    challenges: Sequence[Matrix],
    original: Matrix,
) -> Ratios:
    """Return the results at one level as ratios to Random's, with the significant differences."""
    names = [matrix.challenge for matrix in challenges]
    keys = zip(table["teacher"].astype(str), table["challenge"].astype(str), strict=True)
    means = dict(zip(keys, table[mean].astype(float), strict=True))
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
    best_of = {name: max(value for (_, other), value in means.items() if other == name) for _, name in means}
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
    """Yield sentences about results without a finite ratio, and about teachers without results."""
    baseline = label(BASELINE)
    gaps: dict[str, list[str]] = {}
    for name, random in zip(names, lower, strict=True):
        words = name.replace("_", " ")
        positive = {teacher: mean for (teacher, other), mean in means.items() if other == name and mean > 0}
        if math.isnan(random):
            yield f"no ratio on {words}: {baseline} has no result"
        if random == 0 and positive:
            best = max(positive, key=positive.__getitem__)
            yield (
                f"{words}: {baseline} is at 0, and who is over 0 beyond the rings, best "
                f"{label(best)} with {number(positive[best])}"
            )
    for teacher in teachers:
        absent = [name.replace("_", " ") for name in names if (teacher, name) not in means]
        if absent and not is_baseline(teacher):
            suffix = "" if len(absent) == len(names) else f" on {', '.join(absent)}"
            gaps.setdefault(suffix, []).append(label(teacher))
    for suffix, labels in sorted(gaps.items()):
        yield f"no results of {', '.join(labels)}{suffix}"

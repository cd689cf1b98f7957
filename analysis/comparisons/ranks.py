"""Ranks of teachers over all challenges at once, and those that the tests leave open."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.comparisons.aggregates import ACROSS, stratified_differences, stratified_means
from analysis.comparisons.few_seeds import in_brief
from analysis.data.reference import is_baseline
from analysis.formatting import amount, listed
from analysis.measures.tested import MEASURE
from analysis.names import label
from analysis.statistics import SIGNIFICANCE, holm

EQUAL = 1e-9
"""Difference of means, in points, below which two teachers share a rank."""


@dataclass(frozen=True)
class Rank:
    """A teacher's rank among those that have results on all of its challenges.

    Attributes:
        teacher: who.
        across: values of `ACROSS`, what all that are ranked have in common.
        challenges: on how many challenges.
        mean: mastered test tasks in per cent, the mean over challenges of equal weight.
        low: lower end of its 95 % interval; NaN with one run on a challenge.
        high: upper end of it.
        n: runs.
        fewest: of them on one challenge, or of another ranked teacher.
        rank: 1 for the highest mean.
        of: how many teachers are ranked.
        better: those that it is better than, with p < 0.05 after Holm's correction.
        worse: those that it is worse than, likewise.
        undecided: the others.
        left_out: those without results on all of its challenges.
    """

    teacher: str
    across: dict[str, Any]
    challenges: int
    mean: float
    low: float
    high: float
    n: int
    fewest: int
    rank: int
    of: int
    better: tuple[str, ...]
    worse: tuple[str, ...]
    undecided: tuple[str, ...]
    left_out: tuple[str, ...]

    @property
    def best(self) -> int:
        """The best rank that the tests leave open."""
        return 1 + len(self.worse)

    @property
    def worst(self) -> int:
        """The worst rank that the tests leave open."""
        return self.of - len(self.better)

    def describe(self) -> str:
        """Returns rank and verdicts in one sentence."""
        where = f"expert knowledge {self.across['expert_knowledge']}, {amount(self.across['steps'])} steps"
        where += f", {self.across['variant']}" if self.across["variant"] else ""
        over = f"Over {self.challenges} challenge{'s' if self.challenges > 1 else ''} ({where})"
        if self.of == 1:
            return (
                f"{over} {label(self.teacher)} has no rank: no other teacher has results on the same "
                f"challenges under the same conditions."
            )
        best, worst = self.best, self.worst
        certain = f"and the tests leave {best} to {worst} open" if best < worst else "as the tests confirm"
        parts = [("better than", self.better), ("worse than", self.worse)]
        said = [f"{words} {_listed(names)}" for words, names in parts if names]
        said += [f"undecided against {_listed(self.undecided)}"] if self.undecided else []
        lacking = f"; not ranked, lacking challenges: {_listed(self.left_out)}" if self.left_out else ""
        family = f"after Holm for all pairs{in_brief(self.fewest)}"
        return (
            f"{over} {label(self.teacher)} ranks {self.rank} of {self.of} by mean, {certain}: "
            f"{'; '.join(said)} (p < {SIGNIFICANCE} {family}){lacking}."
        )


def ranks(runs: pd.DataFrame, teachers: Collection[str] | None = None, measure: str = MEASURE) -> list[Rank]:
    """Returns the rank of each teacher at each level and budget, the best first.

    One family at each, corrected by Holm: the tests of the pairs of which one is looked at, and of which the
    other has results on all of its challenges. What is not ranked costs no power.

    Args:
        runs: rows of `pooling.pool_runs`.
        teachers: whose ranks; all by default.
        measure: column of `runs`.
    """
    found: list[Rank] = []
    for key, group in runs[runs[measure].notna()].groupby(ACROSS, dropna=False, sort=True):
        across = dict(zip(ACROSS, key, strict=True))
        present = sorted(group["teacher"].unique())
        looked = [name for name in present if teachers is None or name in teachers]
        means = {row["teacher"]: row for row in stratified_means(group, measure).to_dict("records")}
        tests = _tests(group, measure, {name: means[name]["challenges"] for name in looked})
        here = [_rank(name, across, means[name], tests[tests["teacher"] == name]) for name in looked]
        found += sorted(here, key=lambda rank: (-rank.mean, rank.teacher))
    return found


def _tests(group: pd.DataFrame, measure: str, challenges: Mapping[str, int]) -> pd.DataFrame:
    """Returns the test of each teacher that is looked at against every other one: its columns, and holm.

    Args:
        group: runs.
        measure: column of `group`.
        challenges: how many each of these teachers has; holm is NaN where neither is ranked beside the other.
    """
    parts, columns = [], ["teacher", "other", "challenges", "fewest", "difference", "p"]
    for teacher in challenges:
        table = stratified_differences(group, measure, teacher)
        flipped = table.assign(other=table["teacher"], teacher=teacher, difference=-table["difference"])
        parts.append(flipped[columns])
    tests = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)
    pairs = [" | ".join(sorted(names)) for names in zip(tests["teacher"], tests["other"], strict=True)]
    ranked = tests["challenges"] == tests["teacher"].map(challenges)
    counted = zip(pairs, tests["p"].astype(float), ranked, strict=True)
    once = {pair: p for pair, p, counts in counted if counts}
    corrected = dict(zip(once, holm(pd.Series(once, dtype=float)), strict=True))
    return tests.assign(holm=[corrected.get(pair, np.nan) for pair in pairs])


def _rank(teacher: str, across: dict[str, Any], mine: dict[Hashable, Any], tests: pd.DataFrame) -> Rank:
    alike = tests[tests["challenges"] == mine["challenges"]]
    sure = alike["holm"] < SIGNIFICANCE
    ahead = alike["difference"] > 0
    return Rank(
        teacher=teacher,
        across=across,
        challenges=int(mine["challenges"]),
        mean=float(mine["difference"]),
        low=float(mine["low"]),
        high=float(mine["high"]),
        n=int(mine["n"]),
        fewest=int(alike["fewest"].min()) if len(alike) else int(mine["n"]),
        rank=1 + int((alike["difference"] < -EQUAL).sum()),
        of=1 + len(alike),
        better=_names(alike[sure & ahead]),
        worse=_names(alike[sure & ~ahead]),
        undecided=_names(alike[~sure]),
        left_out=_names(tests[tests["challenges"] != mine["challenges"]]),
    )


def _names(tests: pd.DataFrame) -> tuple[str, ...]:
    """Returns the others of some tests, Random first, then by name."""
    return tuple(sorted(tests["other"], key=lambda name: (not is_baseline(name), name)))


def _listed(names: tuple[str, ...]) -> str:
    return f"{len(names)} ({listed(map(label, names))})"

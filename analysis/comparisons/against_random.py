"""Differences from Random over all challenges: during training, at the end, and per trained step."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.comparisons.pairwise import over_challenges
from analysis.data.columns import ACROSS, CONDITIONS, STRATA
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE, NO_BASELINE, core_of
from analysis.formatting import few_seeds_suffix, interval_text, number
from analysis.measures.pooling import condition_words, varying
from analysis.measures.run_measures import NEARLY_ALL, Curves, trained_areas, trained_curves, trained_shares
from analysis.measures.tested import AXES, FINAL, HEADLINE, TRAINED, on_both_axes, verdict
from analysis.names import label
from analysis.statistics.tests import SINGLE_RUN

LARGEST = 100.0  # largest possible difference, in points

FAMILY = "the core against Random; a newcomer is tested alone"  # family of the tests of `against_random`


@dataclass(frozen=True)
class Gap:
    """Difference between two teachers in percentage points, with its interval and verdict."""

    value: float  # difference of the means
    low: float  # lower end of the interval, simultaneous over the family of tests
    high: float  # upper end of the interval
    verdict: str  # `Verdict`, or the reason for no test

    @classmethod
    def of(cls, test: pd.Series | Mapping[str, Any]) -> "Gap":
        """Create a `Gap` from a test, a row from `pairwise.pairwise`."""
        low, high = np.clip([test["simultaneous_low"], test["simultaneous_high"]], -LARGEST, LARGEST)
        return cls(float(test["difference"]), float(low), float(high), verdict(test))

    def __str__(self) -> str:
        ends = f"[{SINGLE_RUN}]" if self.verdict == SINGLE_RUN else interval_text(self.low, self.high)
        return f"{number(self.value)} {ends}"


@dataclass(frozen=True)
class AgainstRandom:
    """Comparison of a teacher with Random over all challenges on which both have results."""

    teacher: str  # name of the teacher
    newcomer: bool  # True if the teacher is not in the core, and therefore tested alone
    across: Mapping[str, Any]  # conditions: values of `ACROSS`
    challenges: int  # number of challenges
    fewest: int  # minimum number of runs of either teacher in a stratum
    gaps: Mapping[str, Gap]  # differences by measure; `TRAINED` only below `NEARLY_ALL` % of trained steps

    @property
    def verdict(self) -> str:
        """Verdicts for the mean over training and the final results, and per trained step where available."""
        words = on_both_axes(self.gaps[HEADLINE].verdict, self.gaps[FINAL].verdict)
        return f"{words}; per trained step {self.gaps[TRAINED].verdict}" if TRAINED in self.gaps else words


def against_random(frames: Frames, runs: pd.DataFrame) -> list[AgainstRandom]:
    """Return each teacher's comparison with Random, by level and budget, largest difference first.

    Args:
        frames: results with windows of training.
        runs: rows from `pooling.pool_runs`.
    """
    shares = trained_shares(frames)
    comparisons: list[AgainstRandom] = []
    for key, group in runs.groupby(ACROSS, dropna=False, sort=True):
        core, across = core_of(group), dict(zip(ACROSS, key, strict=True))
        tests: dict[str, dict[str, Any]] = {
            axis: {test["first"]: test for test in over_challenges(group, axis, BASELINE).to_dict("records")}
            for axis in AXES
        }
        trained = group["run_id"].map(shares).groupby(group["teacher"]).median()
        curves = trained_curves(frames) if (trained < NEARLY_ALL).any() else {}
        compared = []
        for teacher, test in tests[HEADLINE].items():
            if test["reason"] == NO_BASELINE:
                continue
            gaps = {axis: Gap.of(rows[teacher]) for axis, rows in tests.items()}
            if trained[teacher] < NEARLY_ALL:
                gaps[TRAINED] = _per_trained_step(
                    curves, group[group["teacher"].isin(core | {teacher})], teacher
                )
            sizes = int(test["challenges"]), int(test["fewest"])
            compared.append(AgainstRandom(str(teacher), teacher not in core, across, *sizes, gaps))
        comparisons += sorted(compared, key=lambda entry: -entry.gaps[HEADLINE].value)
    return comparisons


def _per_trained_step(curves: Curves, runs: pd.DataFrame, teacher: str) -> Gap:
    """Return a teacher's difference from Random per trained step, given its runs and those of the core."""
    tests = over_challenges(trained_areas(curves, runs, teacher, STRATA), TRAINED, BASELINE)
    return Gap.of(tests[tests["first"] == teacher].iloc[0])


def sentences_against_random(
    comparisons: Collection[AgainstRandom], teachers: Collection[str] | None = None
) -> Iterator[str]:
    """Yield a sentence for each verdict over several challenges, naming the teachers it applies to.

    Args:
        comparisons: results from `against_random`.
        teachers: teachers to name; all by default.
    """
    chosen = [
        entry
        for entry in comparisons
        if entry.challenges > 1 and (teachers is None or entry.teacher in teachers)
    ]
    if not chosen:
        return
    conditions = pd.DataFrame([entry.across for entry in chosen])
    named = ["steps", *varying(conditions), *(["variant"] if (conditions["variant"] != "").any() else [])]
    groups: dict[str, list[str]] = {}
    for entry in chosen:
        words = condition_words(pd.Series(entry.across), [name for name in CONDITIONS if name in named])
        where = ", ".join([f"expert knowledge {entry.across['expert_knowledge']}", *words])
        lead = f"Over {entry.challenges} challenges ({where}), beside Random: {entry.verdict}"
        gaps = ", ".join(f"{entry.gaps[axis]} {words}" for axis, words in AXES.items())
        few = few_seeds_suffix(entry.fewest).replace("; ", ", ")
        groups.setdefault(lead, []).append(f"{label(entry.teacher)} ({gaps}{few})")
    yield from (f"{lead}, in points: {'; '.join(gaps)}." for lead, gaps in groups.items())

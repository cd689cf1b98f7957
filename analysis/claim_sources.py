"""Where claims are looked up: in results of ours, or in the paper's own tables."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import pandas as pd

from analysis.claims import Sample
from analysis.frames import Frames
from analysis.measures import is_baseline
from analysis.pooling import pooled
from analysis.statistics import Description, describe
from analysis.student_pools import runs_after
from tma_ray.benchmark import PaperResult, paper_results
from tma_ray.benchmark.statements import Reading

MEASURE = "mastered_percent"


class PaperSource:
    """The paper's tables; they hold final results, and single bodies of Parkour only."""

    def sample(self, reading: Reading) -> Sample | None:
        """Returns n, mean and std of the entry, None where the tables have none."""
        entries = [result for result in _entries(reading) if result.teacher == reading.teacher]
        if reading.share < 1 or not entries:
            return None
        entry = max(entries, key=lambda result: result.seeds)
        return Sample(Description(entry.seeds, entry.mean, entry.std))

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Returns who has an entry there."""
        return sorted({result.teacher for result in _entries(reading)})


class RootSource:
    """Complete pools of the runs of one root; Random lends its runs to levels at which it was not run.

    Where several pools have results of a challenge, as of two kinds of students, the largest counts.
    """

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self._read = cache(self._read_after)

    def sample(self, reading: Reading) -> Sample | None:
        """Returns the runs of the reading, None unless all of its pool are there."""
        table, runs = self._read(reading.share)
        by = ["embodiment"] if reading.embodiment else []
        found = _at(table[bool(by)], reading)
        found = found[(found["teacher"] == reading.teacher) & (found["missing"] == "")]
        if found.empty:
            return None
        best = found.sort_values("n", kind="stable").iloc[-1]
        keys = ["environment", "challenge", "pool", "expert_knowledge", "steps", "teacher", *by]
        mine = runs[(runs[keys] == best[keys].tolist()).all(axis=1)]
        values = mine.dropna(subset=[MEASURE]).set_index("run_id")[MEASURE]
        return Sample(describe(values), values)

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Returns who has complete results there."""
        table, _ = self._read(reading.share)
        found = _at(table[bool(reading.embodiment)], reading)
        return sorted(found[found["missing"] == ""]["teacher"].unique())

    def _read_after(self, share: float) -> tuple[tuple[pd.DataFrame, pd.DataFrame], pd.DataFrame]:
        """Returns results over bodies, results of each body, and runs, after a share of the budget."""
        runs = runs_after(self._frames, share)
        return (pooled(runs, [MEASURE]), pooled(runs, [MEASURE], by=["embodiment"])), runs


def _entries(reading: Reading) -> list[PaperResult]:
    wanted = (reading.environment, reading.challenge, reading.level)
    return [
        result
        for result in paper_results()
        if (result.environment, result.challenge, result.expert_knowledge) == wanted
        and (not reading.embodiment or result.embodiments == (reading.embodiment,))
        and not (result.doubt and not is_baseline(result.teacher))
    ]


def _at(table: pd.DataFrame, reading: Reading) -> pd.DataFrame:
    found = table[
        (table["environment"] == reading.environment)
        & (table["challenge"] == reading.challenge)
        & (table["expert_knowledge"] == reading.level.value)
    ]
    return found[found["embodiment"] == reading.embodiment] if reading.embodiment else found

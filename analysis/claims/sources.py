"""Sources that claims are held against: results of roots, and the paper's own tables."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import pandas as pd

from analysis.claims.judging import Sample, Verdict, judge
from analysis.data.frames import Frames
from analysis.data.reference import is_baseline
from analysis.measures.conditions import CONDITIONS, condition_words, varying
from analysis.measures.pooling import pooled
from analysis.measures.shared_students import seeds_to_pair
from analysis.measures.student_pools import runs_after
from analysis.measures.variants import BIPEDAL, RELEASED_BIPEDAL
from analysis.statistics import Description, describe
from analysis.statistics.verdicts import Standing
from tma_ray.benchmark import PaperResult, paper_results
from tma_ray.benchmark.statements import Reading
from tma_ray.results import BOX2D

MEASURE = "mastered_percent"

POOL = ["environment", "challenge", "pool", "expert_knowledge", "steps", "teacher"]
"""Columns that the runs of a result have in common."""

PLACE = ("environment", "challenge", "expert_knowledge")
"""Columns that tell results of one place from others."""


PAPERS = "the paper's bodies, students and test tasks"


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
    """Complete pools of the runs of one root, all under the same conditions; Random serves at every level.

    Results under several conditions, such as two budgets or students, are never held against each other:
    those that complete the most pools count, and of several the largest budget.

    Attributes:
        note: which conditions count and that others do not, in words; empty where all are alike.
    """

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self._read = cache(self._read_after)
        self._places = cache(self._places_after)
        self._grouped = cache(self._positions)
        self._samples = cache(self._sample)
        self._conditions, self.note = _chosen_conditions(runs_after(frames))
        columns = ["environment", "challenge", "teacher"]
        self._present = set(frames.cells[columns].itertuples(index=False, name=None))

    def sample(self, reading: Reading) -> Sample | None:
        """Returns the runs of the reading, None unless all of its pool are there."""
        return self._samples(reading)

    def _sample(self, reading: Reading) -> Sample | None:
        if (reading.environment, reading.challenge, reading.teacher) not in self._present:
            return None
        found = self._complete(reading)
        if found is None or (found := found[found["teacher"] == reading.teacher]).empty:
            return None
        best = found.sort_values("n", kind="stable").iloc[-1]
        keys = [*POOL, "embodiment"] if reading.embodiment else POOL
        mine = self._grouped(reading.share, bool(reading.embodiment)).get(tuple(best[keys]), [])
        columns = self._read(reading.share)[[MEASURE, "run_id", "seed", "engine"]].take(mine)
        values = pd.Series(columns[MEASURE].to_numpy(float), columns["run_id"].to_numpy(object)).dropna()
        return Sample(describe(values), values, seeds_to_pair(columns))

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Returns who has complete results there."""
        found = self._complete(reading)
        return [] if found is None else sorted(found["teacher"].unique())

    def _positions(self, share: float, by_body: bool) -> dict[Any, Any]:
        """Returns the rows of the runs after a share of the budget, by `POOL` (and embodiment)."""
        keys = [*POOL, "embodiment"] if by_body else POOL
        return dict(self._read(share).groupby(keys, observed=True).indices)

    def _complete(self, reading: Reading) -> pd.DataFrame | None:
        """Returns the complete results where `reading` is read, None if there are none."""
        return self._places(reading.share, bool(reading.embodiment)).get(_place(reading))

    def _read_after(self, share: float) -> pd.DataFrame:
        """Returns the runs that count, after a share of their budgets."""
        runs = runs_after(self._frames, share, training=share == 1)  # of which the page shows more
        return runs[_under(runs, self._conditions)]

    def _places_after(self, share: float, by_body: bool) -> dict[tuple[str, ...], pd.DataFrame]:
        """Returns the complete results after a share of the budget by place, over bodies or of each."""
        by = ["embodiment"] if by_body else []
        table = pooled(self._read(share), [MEASURE], by=by)
        groups = table[table["missing"] == ""].groupby([*PLACE, *by], observed=True)
        places = {tuple(map(str, key)): group for key, group in groups}
        for key, group in list(places.items()):
            theirs = group[group["engine"] == BOX2D]
            if key[-1] == RELEASED_BIPEDAL and len(theirs):
                places.setdefault((*key[:-1], BIPEDAL), theirs)
        return places


def _chosen_conditions(runs: pd.DataFrame) -> tuple[pd.Series | None, str]:
    """Returns the conditions under which claims are judged, and a sentence where there are others."""
    runs = runs[runs["steps"].notna()]
    if runs.empty:
        return None, ""
    table = pooled(runs, [MEASURE])
    counts = table.assign(complete=table["missing"] == "").groupby(CONDITIONS, dropna=False)["complete"].sum()
    ordered = counts.reset_index().sort_values(["complete", "steps"], ascending=False, kind="stable")
    chosen = ordered.iloc[0][CONDITIONS]
    if len(ordered) == 1:
        return chosen, ""
    told = varying(ordered)
    own = ", ".join(condition_words(chosen, told)) or PAPERS
    others = [", ".join(condition_words(row, told)) or PAPERS for _, row in ordered.iloc[1:].iterrows()]
    apart = " and of ".join(others)
    return chosen, f"Claims are judged by results of {own} alone; apart stand those of {apart}."


def _under(runs: pd.DataFrame, conditions: pd.Series | None) -> pd.Series:
    """Returns which runs were made under these conditions."""
    fits = pd.Series(conditions is not None, index=runs.index)
    for column, value in () if conditions is None else conditions.items():
        fits &= runs[str(column)].isna() if pd.isna(value) else runs[str(column)] == value
    return fits


def _entries(reading: Reading) -> list[PaperResult]:
    wanted = (reading.environment, reading.challenge, reading.level)
    return [
        result
        for result in paper_results()
        if (result.environment, result.challenge, result.expert_knowledge) == wanted
        and (not reading.embodiment or result.embodiments == (reading.embodiment,))
        and not (result.doubt and not is_baseline(result.teacher))
    ]


def _place(reading: Reading) -> tuple[str, ...]:
    place = (reading.environment, reading.challenge, reading.level.value)
    return (*place, reading.embodiment) if reading.embodiment else place


def decided(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Returns those of `verdicts` of which the results say anything, if only about one statement."""
    return [
        verdict
        for verdict in verdicts
        if any(finding.standing is not Standing.NO_DATA for finding in verdict.findings)
    ]


def root_verdicts(frames: Frames) -> tuple[list[Verdict], list[str]]:
    """Returns what the results of a root say of each of the paper's claims, and notes.

    These say which of the results claims are judged by, where there are several kinds.
    """
    source = RootSource(frames)
    return judge(source), [source.note] if source.note else []

"""All that was measured over a root, whole or for one comparison of teachers."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from math import nan

import pandas as pd

from analysis.comparisons.against_random import Randoms, against_baseline, randoms_of
from analysis.data.frames import COMPARISON, Frames
from analysis.measures.evaluations import evaluation_curves, final_evaluations, summarise
from analysis.measures.run_measures import run_measures
from analysis.measures.training import training_curves

TESTED = ("mastered_percent", "evaluation_return", "mastered_area")
"""Mastered tasks and test return at the end, and mastered tasks on average over training."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Frames that all have the columns of `load.COMPARISON`.

    Attributes:
        cells: of `Frames`.
        finals: one row per run, of `evaluations.final_evaluations`.
        summary: one row per teacher, of `summarise`.
        tests: of `measures.against_baseline`, for each of `TESTED`.
        evaluations: of `evaluation_curves`.
        training: of `measures.training_curves`.
    """

    cells: pd.DataFrame
    finals: pd.DataFrame
    summary: pd.DataFrame
    tests: pd.DataFrame
    evaluations: pd.DataFrame
    training: pd.DataFrame

    @cached_property
    def randoms(self) -> Randoms:
        """The evaluations of Random, of `randoms_of`."""
        return randoms_of(self.evaluations)

    @cached_property
    def comparisons(self) -> tuple[Measured, ...]:
        """The part of each comparison, in a fixed order."""
        tables = [getattr(self, field.name) for field in fields(self)]
        parts = [dict(list(table.groupby(COMPARISON))) if len(table) else {} for table in tables]
        keys = self.cells[COMPARISON].drop_duplicates().sort_values(COMPARISON)
        return tuple(
            Measured(*(mine.get(key, table.head(0)) for mine, table in zip(parts, tables, strict=True)))
            for key in keys.itertuples(index=False, name=None)
        )


def measure(frames: Frames) -> Measured:
    """Returns everything that is measured of a root."""
    finals, training = final_evaluations(frames), training_curves(frames)
    evaluations = evaluation_curves(frames)
    area = run_measures(frames).set_index("run_id")["mastered_area"]  # of runs that have ended
    ends, curves = (
        finals.assign(mastered_area=finals["run_id"].map(area)),
        evaluations.assign(mastered_area=nan),
    )
    tests = [against_baseline(ends, curves, name) for name in TESTED]
    return Measured(
        cells=frames.cells,
        finals=finals,
        summary=summarise(frames, finals),
        tests=pd.concat(tests, ignore_index=True),
        evaluations=evaluations,
        training=training,
    )

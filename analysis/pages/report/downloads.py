"""The tables that a report embeds and leaves beside itself."""

from __future__ import annotations

import gzip
from dataclasses import dataclass

import pandas as pd

from analysis.comparisons.measured import Measured
from analysis.data.frames import Frames
from analysis.measures.evaluations import aggregate, mastered_tasks
from analysis.measures.run_measures import run_measures


@dataclass(frozen=True)
class Download:
    """A CSV file of the report: its name, what a row of it is, and its content."""

    name: str
    row: str
    content: bytes

    @property
    def compressed(self) -> bytes:
        """The content as gzip has it, always the same: what the page holds is a quarter as large."""
        return gzip.compress(self.content, mtime=0)


def downloads(frames: Frames, measured: Measured) -> list[Download]:
    """Returns the tables of a report, in order."""
    curves = [
        aggregate(table, value).assign(measure=value)
        for table, value in (
            (measured.evaluations, "mastered_percent"),
            (measured.evaluations, "evaluation_return"),
            (measured.training, "training_return"),
        )
    ]
    tasks = mastered_tasks(frames, measured.finals).merge(
        frames.test_tasks.assign(
            task=frames.test_tasks["task"].map(lambda task: " ".join(f"{x:g}" for x in task))
        )
    )
    tables = {
        "summary": ("one teacher in one comparison", measured.summary),
        "seeds": ("one run at its final evaluation", measured.finals),
        "tests": ("one test against Random, with Holm's adjustment of p", measured.tests),
        "learning_curves": ("one measure of one teacher at one step", pd.concat(curves, ignore_index=True)),
        "mastered_tasks": ("one test task and the share of seeds that master it", tasks),
        "measures": ("one run: area under its curve, steps to a share, forgetting", run_measures(frames)),
        "runs": ("one run of one cell and its state", frames.cells.drop(columns="spec")),
    }
    return [
        Download(f"{name}.csv", row, table.to_csv(index=False, lineterminator="\n").encode())
        for name, (row, table) in tables.items()
    ]

"""Published scalars of runs, as trackers of experiments show them, once or again and again."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, Protocol

import numpy as np
import pandas as pd

from analysis.data.identity import mastery_threshold
from analysis.data.tables import evaluation_measures, with_plain_texts
from tma_ray.results import Manifest, Results, Table

WATCH_SECONDS: Final = 10.0
"""Time between two looks at a root that is watched, s."""

TRAINING: Final = ("mean_return", "mean_length", "success_share")
EVALUATION: Final = {"evaluation_return": "mean_return", "mastered_percent": "mastered_percent"}
TABLES: Final = (Table.TRAINING, Table.EVALUATIONS, Table.TEACHER_LOG)

LARGEST: Final = float(np.finfo(np.float32).max)
"""Event files hold float32."""

Point = tuple[int, dict[str, float]]
"""A step, and the scalars there by their tags."""


class Tracker(Protocol):
    """A tracker of experiments that takes what has been published."""

    def update(self) -> int:
        """Hand over what is new; returns of how many runs there was something."""
        ...


def watch(tracker: Tracker) -> Iterator[int]:
    """Update every few seconds; yields of how many runs there was something, whenever there was any."""
    while True:
        time.sleep(WATCH_SECONDS)
        if count := tracker.update():
            yield count


def experiments_of(results: Results, manifests: Iterable[Manifest]) -> dict[str, str]:
    """Return the experiment of each run by its ID, the first by name of those that share it."""
    cells = _rows(results, Table.CELLS, _ids(manifests), ["run_id", "campaign", "experiment"])
    cells = cells.sort_values(["campaign", "experiment"], kind="stable").drop_duplicates("run_id")
    return dict(zip(cells["run_id"], cells["experiment"], strict=True))


def published_points(results: Results, manifests: Sequence[Manifest]) -> dict[tuple[str, Table], list[Point]]:
    """Return the points of each run and table, in the order in which they were published."""
    run_ids = _ids(manifests)
    thresholds = {manifest.run.run_id: mastery_threshold(manifest.run.spec) for manifest in manifests}
    training = _rows(results, Table.TRAINING, run_ids, ["run_id", "step", *TRAINING])
    evaluations = _rows(results, Table.EVALUATIONS, run_ids, ["run_id", "step", "episodic_return"])
    needed = evaluations["run_id"].map(thresholds).astype(float)
    evaluations["mastered"] = evaluations["episodic_return"] > needed
    measured = evaluation_measures(evaluations).rename(columns=EVALUATION)
    updates = _rows(results, Table.TEACHER_LOG, run_ids, ["run_id", "step", "scalars"])
    found: dict[tuple[str, Table], list[Point]] = {}
    for run_id, step, point in _scalars(training, "training", TRAINING):
        found.setdefault((run_id, Table.TRAINING), []).append((step, point))
    for run_id, step, point in _scalars(measured, "evaluation", EVALUATION.values()):
        found.setdefault((run_id, Table.EVALUATIONS), []).append((step, point))
    for run_id, step, scalars in updates.itertuples(index=False):
        point = _finite({f"teacher/{name}": value for name, value in scalars or ()})
        found.setdefault((run_id, Table.TEACHER_LOG), []).append((step, point))
    return found


def _rows(results: Results, table: Table, run_ids: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    frame: pd.DataFrame = results.table(table, run_ids, columns).to_pandas()
    return with_plain_texts(frame)


def _ids(manifests: Iterable[Manifest]) -> list[str]:
    return [manifest.run.run_id for manifest in manifests]


def _scalars(
    rows: pd.DataFrame, prefix: str, names: Iterable[str]
) -> Iterator[tuple[str, int, dict[str, float]]]:
    tags = {name: f"{prefix}/{name}" for name in names}
    for row in rows.to_dict("records"):
        yield row["run_id"], row["step"], _finite({tag: row[name] for name, tag in tags.items()})


def _finite(scalars: Mapping[str, float]) -> dict[str, float]:
    return {tag: value for tag, value in scalars.items() if abs(value) <= LARGEST}

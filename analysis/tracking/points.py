"""Published points (steps with their scalars) of runs, for experiment trackers."""

import time
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from analysis.data.frames import with_plain_texts
from analysis.data.loading import evaluation_measures
from analysis.data.specs import mastery_threshold
from tma_ray.results import Manifest, Results, Table, experiments_of

UPDATE_SECONDS: Final = 10.0  # time between two updates of a tracker, in seconds

TRAINING: Final = ("mean_return", "mean_length", "success_share")
EVALUATION: Final = {"evaluation_return": "mean_return", "mastered_percent": "mastered_percent"}
TRACKED_TABLES: Final = (Table.TRAINING, Table.EVALUATIONS, Table.TEACHER_LOG)

LARGEST_FLOAT: Final = float(np.finfo(np.float32).max)
"""Largest value of event files, which hold float32."""

Point = tuple[int, dict[str, float]]  # step, and scalars by tag


RUNS_AT_ONCE: Final = 32
"""Number of runs that are read together, a compromise between requests to an object store and memory."""


class Tracker(ABC):
    """Experiment tracker to which every published point of a root's runs is written once.

    Args:
        root: folder, or ``s3://`` or ``gs://`` address.

    Raises:
        ResultsRootError: if the results root is missing or of another version.
    """

    def __init__(self, root: str | Path) -> None:
        Results.open(root)  # to fail early if this is not a results root
        self._root = root
        self._files: dict[str, object] = {}  # files in each run's manifest at the last update

    def update(self) -> int:
        """Write the points published since the last update.

        Returns:
            Number of runs with new points.

        Raises:
            ValueError: if the tracker refuses the points.
        """
        results, count = Results.open(self._root), 0
        changed = [run for run in results.runs() if self._files.get(run.run.run_id) != run.files]
        for start in range(0, len(changed), RUNS_AT_ONCE):
            manifests = changed[start : start + RUNS_AT_ONCE]
            published = published_points(results, manifests)
            experiments = experiments_of(results, _ids(manifests))
            for manifest in manifests:
                run_id = manifest.run.run_id
                points = {table: published.get((run_id, table), []) for table in TRACKED_TABLES}
                count += self._write(manifest, points, experiments.get(run_id, "single runs"))
                self._files[run_id] = manifest.files
        return count

    @abstractmethod
    def _write(self, manifest: Manifest, points: Mapping[Table, Sequence[Point]], experiment: str) -> bool:
        """Write the new points of a run, and return True if there were any."""


def watch(tracker: Tracker) -> Iterator[int]:
    """Update `tracker` periodically, without end, and yield the number of runs with new points if any."""
    while True:
        time.sleep(UPDATE_SECONDS)
        if count := tracker.update():
            yield count


def published_points(results: Results, manifests: Sequence[Manifest]) -> dict[tuple[str, Table], list[Point]]:
    """Return the points of each run and table, in order of publication."""
    run_ids = _ids(manifests)
    thresholds = {manifest.run.run_id: mastery_threshold(manifest.run.spec) for manifest in manifests}
    training = _rows(results, Table.TRAINING, run_ids, ["run_id", "step", *TRAINING])
    evaluations = _rows(results, Table.EVALUATIONS, run_ids, ["run_id", "step", "episodic_return"])
    evaluations["mastered"] = evaluations["episodic_return"] > evaluations["run_id"].map(thresholds).astype(
        float
    )
    measured = evaluation_measures(evaluations).rename(columns=EVALUATION)
    updates = _rows(results, Table.TEACHER_LOG, run_ids, ["run_id", "step", "scalars"])
    points: dict[tuple[str, Table], list[Point]] = defaultdict(list)
    for rows, table, prefix, names in (
        (training, Table.TRAINING, "training", TRAINING),
        (measured, Table.EVALUATIONS, "evaluation", EVALUATION.values()),
    ):
        for row in rows.to_dict("records"):
            point = _finite({f"{prefix}/{name}": row[name] for name in names})
            points[row["run_id"], table].append((row["step"], point))
    for run_id, step, scalars in updates.itertuples(index=False):
        point = _finite({f"teacher/{name}": value for name, value in scalars or ()})
        points[run_id, Table.TEACHER_LOG].append((step, point))
    return points


def _rows(results: Results, table: Table, run_ids: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    frame: pd.DataFrame = results.table(table, run_ids, columns).to_pandas()
    return with_plain_texts(frame)


def _ids(manifests: Iterable[Manifest]) -> list[str]:
    return [manifest.run.run_id for manifest in manifests]


def _finite(scalars: Mapping[str, float]) -> dict[str, float]:
    return {tag: value for tag, value in scalars.items() if abs(value) <= LARGEST_FLOAT}

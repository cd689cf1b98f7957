"""Published scalars of runs, as trackers of experiments show them, once or again and again."""

import time
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from analysis.data.frames import evaluation_measures, with_plain_texts
from analysis.data.identity import mastery_threshold
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


RUNS_AT_ONCE: Final = 32
"""Number of runs that are read together: fewer wait longer for an object store, more need more memory."""


class Tracker(ABC):
    """A tracker of experiments that runs of a results root are written to.

    Points are read from what the runs have published, and each is written once: an interrupted run goes on
    from a checkpoint, and so has nothing published that it will publish again.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.

    Raises:
        ResultsRootError: no results root at that place, or one of another version.
    """

    def __init__(self, root: str | Path) -> None:
        Results.open(root)  # refuses other places before anything is made
        self._root = root
        self._files: dict[str, object] = {}  # of the manifest of each run, when they were read

    def update(self) -> int:
        """Write the points published since the last update.

        Returns:
            Number of runs of which there was something.

        Raises:
            ValueError: the tracker refuses it; the message says why.
        """
        results, count = Results.open(self._root), 0
        news = [each for each in results.runs() if self._files.get(each.run.run_id) != each.files]
        for start in range(0, len(news), RUNS_AT_ONCE):
            manifests = news[start : start + RUNS_AT_ONCE]
            found, experiments = published_points(results, manifests), first_experiments(results, manifests)
            for manifest in manifests:
                run_id = manifest.run.run_id
                points = {table: found.get((run_id, table), []) for table in TABLES}
                count += self._write(manifest, points, experiments.get(run_id, "single runs"))
                self._files[run_id] = manifest.files
        return count

    @abstractmethod
    def _write(self, manifest: Manifest, points: Mapping[Table, Sequence[Point]], experiment: str) -> bool:
        """Write the points of a run that are new; return True if there were any."""


def watch(tracker: Tracker) -> Iterator[int]:
    """Update every few seconds; yield the number of runs with new points, if any."""
    while True:
        time.sleep(WATCH_SECONDS)
        if count := tracker.update():
            yield count


def first_experiments(results: Results, manifests: Iterable[Manifest]) -> dict[str, str]:
    """Return the experiment of each run by run id; of several, the first by name."""
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
    found: dict[tuple[str, Table], list[Point]] = defaultdict(list)
    for rows, table, prefix, names in (
        (training, Table.TRAINING, "training", TRAINING),
        (measured, Table.EVALUATIONS, "evaluation", EVALUATION.values()),
    ):
        for row in rows.to_dict("records"):
            point = _finite({f"{prefix}/{name}": row[name] for name in names})
            found[row["run_id"], table].append((row["step"], point))
    for run_id, step, scalars in updates.itertuples(index=False):
        point = _finite({f"teacher/{name}": value for name, value in scalars or ()})
        found[run_id, Table.TEACHER_LOG].append((step, point))
    return found


def _rows(results: Results, table: Table, run_ids: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    frame: pd.DataFrame = results.table(table, run_ids, columns).to_pandas()
    return with_plain_texts(frame)


def _ids(manifests: Iterable[Manifest]) -> list[str]:
    return [manifest.run.run_id for manifest in manifests]


def _finite(scalars: Mapping[str, float]) -> dict[str, float]:
    return {tag: value for tag, value in scalars.items() if abs(value) <= LARGEST}

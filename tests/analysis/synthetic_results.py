"""Results roots of plausible synthetic runs, written as by a campaign."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from tma_ray.results import (
    BOX2D,
    BOX2D_TEST_SET,
    NO_PHYSICS_VERSION,
    AttemptOutcome,
    AttemptRecord,
    Committer,
    RunRecord,
    RunWriter,
    Table,
)

FINGERPRINT = json.dumps({"cpu": "Invented CPU @ 3 GHz", "threads": 1, "python": "3.11.9", "numpy": "2.4.6"})
ERROR = 'Traceback (most recent call last):\n  File "run.py", line 1\nMemoryError: buffer of 2 GB'

TASK_SPACE = [
    {"name": "stump_height", "low": 0, "high": 3, "unit": "terrain steps of 0.4667 m"},
    {"name": "obstacle_spacing", "low": 0, "high": 6, "unit": "m"},
]

SKILL = {"random": 0.45, "alp_gmm": 0.8}
"""Share of the task space that a teacher's students master in the end."""


BOX2D_RUN = {
    "spec": json.dumps({"engine": BOX2D}),
    "test_set": f"{BOX2D_TEST_SET}stump_tracks",
    "physics_version": NO_PHYSICS_VERSION,
}
"""Fields of the records of runs with Box2D."""

SMALL = {"steps": 40_000, "evaluation_every": 10_000, "episode_steps": 1_000, "grid": 4, "updates": 4}
"""Sizes of a campaign with complete logs."""


def mastering(count: int, of: int = 10) -> list[float]:
    """Return the returns of test tasks, `count` of which are mastered."""
    return [300.0] * count + [0.0] * (of - count)


@dataclass
class SyntheticCampaign:
    """Writer of synthetic runs that master easy tasks first, and more tasks under better teachers."""

    root: Path
    steps: int = 2_000_000
    evaluation_every: int = 100_000
    grid: int = 10
    episode_steps: int = 4_000
    campaign: str = "first_look"
    experiment: str = "original"
    environment: str = "stump_tracks"
    boxes: bool = False
    updates: int = 20
    error: str = ERROR
    host: str = "node-1"
    prefix: str = ""

    def __post_init__(self) -> None:
        self.committer = Committer.open(self.root)

    def run(
        self,
        teacher: str,
        seed: int,
        status: str = "done",
        upto: float = 1.0,
        level: str = "low",
        shares: Sequence[str] = (),
        **changes: Any,
    ) -> str:
        """Write a synthetic run up to a share of its steps, and its cells at `level` and at `shares`."""
        record = self.record(teacher, seed, level, **changes)
        for cell_level in (level, *shares):
            self.cell(record, cell_level)
        if status != "waiting":
            self._write(record, status, *self._invented(record, upto))
        return record.run_id

    def plain_run(
        self,
        teacher: str,
        seed: int,
        returns: Mapping[int, Sequence[float]],
        status: str = "done",
        level: str = "low",
        **changes: Any,
    ) -> str:
        """Write a run with given returns on the test tasks by step, and without episodes."""
        record = self.record(teacher, seed, level, **changes)
        self.cell(record, level)
        self._plain(record, status, returns)
        return record.run_id

    def seeds(
        self,
        teacher: str,
        counts: Sequence[int],
        of: int = 10,
        half: float | None = None,  # share of these tasks mastered at half time; None: not evaluated
        level: str = "low",
        **changes: Any,
    ) -> None:
        """Write runs with rising seeds that master given numbers of tasks in the end."""
        records = [self.record(teacher, seed, level, **changes) for seed in range(len(counts))]
        self.committer.write_cells(self.campaign, [self._row(record, level) for record in records])
        for record, count in zip(records, counts, strict=True):
            early = {} if half is None else {self.steps // 2: mastering(int(half * count), of)}
            self._plain(record, "done", early | {self.steps: mastering(count, of)})

    def record(self, teacher: str, seed: int, level: str, **changes: Any) -> RunRecord:
        name = f"{self.prefix}{self.experiment}-{teacher}-{level}-{seed}"
        fields: dict[str, Any] = {
            "run_id": re.sub(r"[^0-9a-zA-Z_-]", "_", name),
            "teacher": teacher,
            "seed": seed,
        }
        fields |= {"spec": json.dumps({"seed": seed, "task_space": TASK_SPACE}), "expert_knowledge": level}
        fields |= {"environment": self.environment, "challenge": "original", "embodiment": "classic_bipedal"}
        fields |= {"student": "sac", "test_set": "stump_tracks", "steps": self.steps, "physics_version": 1}
        return RunRecord(**(fields | changes))

    def cell(self, record: RunRecord, level: str) -> None:
        self.committer.write_cells(self.campaign, [self._row(record, level)])

    def _row(self, record: RunRecord, level: str) -> dict[str, Any]:
        names = ("environment", "challenge", "embodiment", "student", "teacher", "seed", "run_id")
        row = {name: getattr(record, name) for name in names}
        return row | {"expert_knowledge": level, "experiment": self.experiment}

    def _plain(self, record: RunRecord, status: str, returns: Mapping[int, Sequence[float]]) -> None:
        rows = [
            {"step": step, "test_set": "line", "task_index": i, "task": [float(i)], "length": 1}
            | {"episodic_return": float(value)}
            for step, values in returns.items()
            for i, value in enumerate(values)
        ]
        self._write(record, status, {Table.EVALUATIONS: rows}, max(returns, default=0))

    def _write(self, record: RunRecord, status: str, tables: Mapping[Table, Any], end: int) -> None:
        attempt = self.committer.start(record)
        writer = RunWriter(self.committer.store, record.run_id, attempt)
        for table, rows in tables.items():
            writer.add(table, rows)
        if status == "done":
            self.committer.finish(record, attempt, writer.finish())
        else:
            self.committer.publish(record, attempt, writer.flush())
        if status == "failed":
            self.committer.fail(record, attempt, self.error)
        outcome = {"done": AttemptOutcome.DONE, "failed": AttemptOutcome.FAILED}.get(status)
        started = datetime(2026, 11, 20, 8, record.seed % 60, tzinfo=UTC)
        if outcome is not None:
            measured = (started, 3600.0, end / 3600, self.host, FINGERPRINT)
            self.committer.record_attempt(AttemptRecord(record.run_id, attempt, *measured, outcome))

    def _invented(self, record: RunRecord, upto: float) -> tuple[dict[Table, Any], int]:
        rng = np.random.default_rng([record.seed, *record.teacher.encode()])
        skill = SKILL.get(record.teacher, 0.6) + rng.normal(0, 0.06)
        end = int(self.steps * upto)
        guided = record.teacher != "random"
        steps, tasks, returns = self._episodes(rng, skill, end, guided)
        tables = {
            Table.EVALUATIONS: self._evaluations(rng, skill, end),
            Table.EPISODES: [
                {"step": int(s), "episode": i, "task": t.astype(np.float32), "episodic_return": float(r)}
                | {"length": self.episode_steps, "success": bool(r > 230)}
                for i, (s, t, r) in enumerate(zip(steps, tasks, returns, strict=True))
            ],
            Table.TRAINING: self._windows(steps, returns),
        }
        return tables | (self._teacher(rng, end) if guided else self._uniform_probes(rng, end)), end

    def _uniform_probes(self, rng: np.random.Generator, end: int) -> dict[Table, Any]:
        steps = range(0, end + 1, self.steps // self.updates)
        tasks = (rng.random((len(steps), 40, 2)) * [3, 6]).astype(np.float32)
        probes = zip(steps, tasks, strict=True)
        rows = [
            {"step": step, "sample": i, "task": task}
            for step, probe in probes
            for i, task in enumerate(probe)
        ]
        return {Table.CURRICULUM: rows}

    def returns(self, tasks: np.ndarray, ability: float, rng: np.random.Generator) -> np.ndarray:
        """Return the returns (n,) on tasks (n, 2), which fall where difficulty exceeds the ability."""
        difficulty = tasks[:, 0] / 3 + 0.35 * (1 - tasks[:, 1] / 6)
        return 300 - 380 / (1 + np.exp(-9 * (difficulty - ability))) + rng.normal(0, 12, len(tasks))

    def _evaluations(self, rng: np.random.Generator, skill: float, end: int) -> list[dict[str, Any]]:
        axis = np.linspace(0, 1, self.grid)
        tasks = np.array([(3 * h, 6 * s) for h in axis for s in axis], dtype=np.float32)
        rows = []
        for step in range(0, end + 1, self.evaluation_every):
            returns = self.returns(tasks, skill * (1 - np.exp(-4 * step / self.steps)) - 0.15, rng)
            rows += [
                {"step": step, "test_set": "stump_tracks", "task_index": i, "task": t, "length": 500}
                | {"episodic_return": float(r)}
                for i, (t, r) in enumerate(zip(tasks, returns, strict=True))
            ]
        return rows

    def _episodes(
        self, rng: np.random.Generator, skill: float, end: int, guided: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        steps = np.arange(self.episode_steps, end + 1, self.episode_steps)
        learning = 1 - np.exp(-4 * steps / self.steps)
        tasks = rng.random((len(steps), 2)) * [3, 6]
        if guided:
            aimed = np.column_stack([0.3 + 2.4 * learning, 4.5 - 3 * learning])
            chosen = rng.random(len(steps)) > 0.2
            tasks[chosen] = (aimed + rng.normal(0, [0.3, 0.7], (len(steps), 2)))[chosen]
            tasks = np.clip(tasks, 0, [3, 6])
        ability = skill * learning - 0.15
        returns = np.array([self.returns(t[None], a, rng)[0] for t, a in zip(tasks, ability, strict=True)])
        return steps, tasks, returns

    def _windows(self, steps: np.ndarray, returns: np.ndarray) -> list[dict[str, Any]]:
        rows = []
        for high in range(500_000, int(steps.max(initial=0)) + 1, 500_000):
            mine = returns[(steps > high - 500_000) & (steps <= high)]
            row = {"step": high, "episodes": len(mine), "mean_return": mine.mean(), "std_return": mine.std()}
            rows.append(row | {"mean_length": 500.0, "success_share": (mine > 230).mean()})
        return rows

    def _teacher(self, rng: np.random.Generator, end: int) -> dict[Table, Any]:
        log, probes = [], []
        for step in range(self.steps // self.updates, end + 1, self.steps // self.updates):
            learning = 1 - np.exp(-4 * step / self.steps)
            mean = np.array([0.3 + 2.4 * learning, 4.5 - 3 * learning])
            gaussians = [
                {"weight": 0.7, "mean": mean, "covariance": [[0.09, 0.05], [0.05, 0.49]]},
                {"weight": 0.3, "mean": mean * 0.7, "covariance": [[0.04, -0.02], [-0.02, 0.3]]},
            ]
            boxes = [{"low": mean * 0.5, "high": mean * 0.8, "score": 0.1}] if self.boxes else []
            row = {"step": step, "episode": step // self.episode_steps, "gaussians": gaussians}
            log.append(row | {"boxes": boxes, "scalars": {"components": 2.0}})
            tasks = np.clip(mean + rng.normal(0, [0.3, 0.7], (40, 2)), 0, [3, 6]).astype(np.float32)
            probes += [{"step": step, "sample": i, "task": task} for i, task in enumerate(tasks)]
        return {Table.TEACHER_LOG: log, Table.CURRICULUM: probes}

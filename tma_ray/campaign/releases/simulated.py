"""Simulated runs as a results root, for all that reads results: rankings, comparisons, releases."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tma_ray.benchmark import BENCHMARK_VERSION
from tma_ray.part_names import base_name
from tma_ray.results import (
    NO_PHYSICS_VERSION,
    SIMULATED,
    Committer,
    RunRecord,
    RunWriter,
    Table,
    keep_plugin,
    spec_digest,
)
from tma_ray.tasks import MASTERY_RETURN
from tma_ray.teachers import TEACHERS, hyperparameters_of, make_teacher
from tma_ray.testing import SimulatedRun, find_simulated_challenge
from tma_ray.testing.matrix import SimulatedCell
from tma_ray.testing.students import EPISODE_STEPS, SIMULATION_VERSION

ENVIRONMENT, STUDENT = "stump_tracks", "simulated"

CAMPAIGN = "simulated"
"""Name of the campaign of simulated cells."""


def write_simulated(
    root: str | Path, cells: Sequence[SimulatedCell], runs: Iterable[SimulatedRun], episodes: int
) -> None:
    """Writes simulated runs and their cells under a results root; runs that it has stay as they are.

    Returns on test tasks are expected ones. Steps are those of episodes of average length.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address; a new or empty one becomes a root.
        cells: what was run.
        runs: all runs of `cells`.
        episodes: of each run.

    Raises:
        ResultsRootError: something else lies there.
    """
    committer = Committer.open(root)
    rows: list[dict[str, Any]] = []
    for run in runs:
        record = _record(run, episodes)
        rows += [_cell(cell, run, record) for cell in cells if _is_of(run, cell)]
        plugin = TEACHERS.plugin(run.teacher)
        if plugin is not None:
            keep_plugin(committer.store, plugin)
        if not committer.done([record.run_id]):
            attempt = committer.start(record)
            writer = RunWriter(committer.store, record.run_id, attempt)
            writer.add(Table.EVALUATIONS, list(_evaluations(run, record.steps)))
            committer.finish(record, attempt, writer.finish())
    committer.write_cells(CAMPAIGN, rows)


def _is_of(run: SimulatedRun, cell: SimulatedCell) -> bool:
    names = cell.challenge.name, cell.teacher, cell.effective_level
    return names == (run.challenge, run.teacher, run.level)


def _record(run: SimulatedRun, episodes: int) -> RunRecord:
    spec = _spec(run, episodes)
    text = json.dumps(spec, sort_keys=True)
    readable = re.sub(r"[^0-9a-zA-Z]+", "_", base_name(run.teacher)).strip("_")
    return RunRecord(
        run_id=f"simulated-{readable}-s{run.seed}-{spec_digest(text)[:12]}",
        spec=text,
        environment=ENVIRONMENT,
        challenge=run.challenge,
        embodiment=STUDENT,
        student=STUDENT,
        teacher=run.teacher,
        expert_knowledge=run.level.value,
        test_set=spec["test_set"]["name"],
        steps=spec["schedule"]["steps"],
        seed=run.seed,
        physics_version=NO_PHYSICS_VERSION,
        benchmark_version=BENCHMARK_VERSION,
    )


def _spec(run: SimulatedRun, episodes: int) -> dict[str, Any]:
    """Returns what determines the run, under the names that specs of real ones have."""
    challenge = find_simulated_challenge(run.challenge)
    tests = challenge.tests()
    plugin = TEACHERS.plugin(run.teacher)
    version = TEACHERS.algorithm_version(run.teacher)
    steps = EPISODE_STEPS * episodes
    return {
        "engine": SIMULATED,
        "environment": ENVIRONMENT,
        "environment_options": {"embodiment": STUDENT},
        "challenge": run.challenge,
        "task_space": [asdict(dimension) for dimension in challenge.task_space.dimensions],
        "easy_task": list(challenge.easy_task),
        "mastery_threshold": MASTERY_RETURN,
        "test_set": {"name": tests.name, "dimensions": list(tests.dimensions), "tasks": tests.tasks.tolist()},
        "student": STUDENT,
        "student_hyperparameters": {},
        "aptitudes": [asdict(each) for each in challenge.aptitudes],
        "teacher": run.teacher,
        "teacher_hyperparameters": hyperparameters_of(make_teacher(run.teacher)),
        "expert_knowledge": run.level.value,
        "schedule": {"steps": steps},
        "seed": run.seed,
        "physics_version": NO_PHYSICS_VERSION,
        "plugins": {"teacher": {"module": plugin.module, "digest": plugin.digest}} if plugin else {},
        "resets": [round(share * steps) for share in challenge.resets],
        "cuts": challenge.cuts,
        "algorithm_versions": {"student": SIMULATION_VERSION}
        | ({"teacher": version} if version is not None else {}),
    }


def _cell(cell: SimulatedCell, run: SimulatedRun, record: RunRecord) -> dict[str, Any]:
    return {
        "experiment": cell.challenge.name,
        "environment": ENVIRONMENT,
        "challenge": cell.challenge.name,
        "embodiment": STUDENT,
        "student": STUDENT,
        "teacher": run.teacher,
        "expert_knowledge": cell.level.value,
        "seed": run.seed,
        "run_id": record.run_id,
    }


def _evaluations(run: SimulatedRun, steps: int) -> Iterable[dict[str, Any]]:
    tests = find_simulated_challenge(run.challenge).tests()
    for point, returns in enumerate(run.returns, start=1):
        for index, (task, value) in enumerate(zip(tests.tasks, returns, strict=True)):
            yield {
                "step": round(steps * point / len(run.returns)),
                "test_set": tests.name,
                "task_index": index,
                "task": task,
                "episodic_return": value,
                "length": EPISODE_STEPS,
            }

"""Results roots of simulated runs, for rankings, comparisons and releases."""

import json
import re
from collections.abc import Collection, Sequence
from dataclasses import asdict
from pathlib import Path

from tma_ray.benchmark import BENCHMARK_VERSION
from tma_ray.results import (
    NO_PHYSICS_VERSION,
    SIMULATED,
    Committer,
    Results,
    RunRecord,
    RunStatus,
    RunWriter,
    Table,
    spec_digest,
    store_plugin,
)
from tma_ray.support.component_names import base_name
from tma_ray.tasks import MASTERY_RETURN, KnowledgeLevel
from tma_ray.teachers import TEACHERS, hyperparameters_of, make_teacher
from tma_ray.testing import SimulatedRun, find_simulated_challenge
from tma_ray.testing.matrix import SimulatedCell, runs_of
from tma_ray.testing.students import EPISODE_STEPS, SIMULATION_VERSION

ENVIRONMENT, STUDENT = "stump_tracks", "simulated"

CAMPAIGN = "simulated"  # name of the campaign of simulated cells

FRACTION = 64
"""Denominator to which returns are rounded; rounding halves the size of a run."""


class SimulatedRoot:
    """Results root of simulated runs; each run is written with its expected returns and episode lengths.

    Raises:
        ResultsRootError: if the folder has other files.
    """

    def __init__(
        self, root: str | Path, cells: Sequence[SimulatedCell], seeds: Sequence[int], episodes: int
    ) -> None:
        self._committer, self._episodes = Committer.open(root), episodes
        self._planned = [
            SimulatedRun(challenge.name, teacher, level, seed, ())
            for challenge, teacher, level in runs_of(cells)
            for seed in seeds
        ]
        records = [_record(run, episodes) for run in self._planned]
        rows = [
            {
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
            for run, record in zip(self._planned, records, strict=True)
            for cell in cells
            if (cell.challenge.name, cell.teacher, cell.effective_level)
            == (run.challenge, run.teacher, run.level)
        ]
        self._committer.write_cells(CAMPAIGN, rows)

    def kept(self) -> list[SimulatedRun]:
        """Return the planned runs that are already in the root."""
        done = self._committer.done(_record(run, self._episodes).run_id for run in self._planned)
        return played_runs(Results(self._committer.store), done)

    def add(self, run: SimulatedRun) -> None:
        """Write a run, and the source of its teacher's plug-in, unless the root already has them."""
        record = _record(run, self._episodes)
        plugin = TEACHERS.plugin(run.teacher)
        if plugin is not None:
            store_plugin(self._committer.store, plugin)
        if not self._committer.done([record.run_id]):
            attempt = self._committer.start(record)
            writer = RunWriter(self._committer.store, record.run_id, attempt)
            tests = find_simulated_challenge(run.challenge).tests()
            rows = [
                {
                    "step": round(record.steps * point / len(run.returns)),
                    "test_set": tests.name,
                    "task_index": index,
                    "task": task,
                    "episodic_return": round(FRACTION * value) / FRACTION,
                    "length": EPISODE_STEPS,
                }
                for point, returns in enumerate(run.returns, start=1)
                for index, (task, value) in enumerate(zip(tests.tasks, returns, strict=True))
            ]
            writer.add(Table.EVALUATIONS, rows)
            self._committer.finish(record, attempt, writer.finish())


def played_runs(results: Results, run_ids: Collection[str] | None = None) -> list[SimulatedRun]:
    """Return the finished runs of simulated students in a results root or release."""
    records = {m.run.run_id: m.run for m in results.runs() if m.status is RunStatus.DONE}
    columns = ["run_id", "step", "task_index", "episodic_return"]
    table = results.table(Table.EVALUATIONS, run_ids, columns).to_pandas().sort_values(columns[:3])
    runs = []
    for run_id, rows in table.groupby("run_id", observed=True):
        if (record := records.get(run_id)) is not None:
            returns = tuple(tuple(map(float, step)) for _, step in rows.groupby("step")["episodic_return"])
            level = KnowledgeLevel(record.expert_knowledge)
            runs.append(SimulatedRun(record.challenge, record.teacher, level, record.seed, returns))
    return runs


def _record(run: SimulatedRun, episodes: int) -> RunRecord:
    """Return the record of a run, with a spec that has the same keys as a `RunSpec`."""
    challenge = find_simulated_challenge(run.challenge)
    tests = challenge.tests()
    plugin = TEACHERS.plugin(run.teacher)
    version = TEACHERS.algorithm_version(run.teacher)
    steps = EPISODE_STEPS * episodes
    spec = {
        "engine": SIMULATED,
        "environment": ENVIRONMENT,
        "environment_options": {"embodiment": STUDENT},
        "challenge": run.challenge,
        "task_space": [asdict(dimension) for dimension in challenge.task_space.dimensions],
        "easy_task": list(challenge.easy_task),
        "mastery_threshold": MASTERY_RETURN,
        "test_set": {
            "name": tests.name,
            "dimensions": list(tests.dimensions),
            "digest": spec_digest(json.dumps(tests.tasks.tolist())),
        },
        "student": STUDENT,
        "student_hyperparameters": {},
        "aptitudes": [asdict(aptitude) for aptitude in challenge.aptitudes],
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
        test_set=tests.name,
        steps=steps,
        seed=run.seed,
        physics_version=NO_PHYSICS_VERSION,
        benchmark_version=BENCHMARK_VERSION,
    )

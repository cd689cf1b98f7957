"""Overhead of actors: a run in this process, in a seed actor, and with the teacher in another actor.

Prints JSON. All three write the same result files; only ratios carry over to other machines. The times of
whole runs include the start of the teacher's process, about a second, during which the first episode waits;
`exchange_milliseconds` is the overhead of later episodes.

    python benchmarks/actor_overhead.py --repeats 3 --output actor_overhead.json
"""

from __future__ import annotations

import argparse
import io
import json
import platform
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from tma_ray.campaign import Campaign
from tma_ray.campaign.cluster.connection import connect
from tma_ray.campaign.execution import execute_plan
from tma_ray.campaign.executors.actors import RemoteTeacher
from tma_ray.campaign.progress import ProgressView
from tma_ray.campaign.settings import ExecutionConfig, TeacherPlacement
from tma_ray.results import Committer, Results, Table
from tma_ray.runs import Cell, InlineTeacher, Schedule, TeacherLink, run_locally
from tma_ray.support.quantities import COUNT
from tma_ray.tasks import Episode, TaskSpace, TestSet

STEPS = {"ppo": 100_000, "sac": 4_000}
HYPERPARAMETERS: dict[str, dict[str, int]] = {"ppo": {}, "sac": {"exploration_steps": 1_000}}


def campaign(student: str, steps: int, folder: Path) -> Campaign:
    """Return a campaign of one run, with evaluations on three tasks at its start and end."""
    space = TaskSpace.from_bounds({"stump_height": (0, 3), "obstacle_spacing": (0, 6)})
    tests = folder / "three.csv"
    tests.write_text(TestSet("three", space.names, space.sample(np.random.default_rng(0), 3)).to_csv())
    cell = Cell(
        student=student,
        teacher="alp_gmm",
        student_hyperparameters=HYPERPARAMETERS[student],
        test_set=str(tests),
    )
    return Campaign("overhead", (cell,), (0,), Schedule(steps=steps))


def steps_per_second(student: str, steps: int, where: str) -> tuple[float, int]:
    """Return the speed of a run's training loop, without set-up, and the number of episodes."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        one, root = campaign(student, steps, folder), folder / "root"
        if where == "process":
            run_locally(one.plan().runs[0], Committer.open(root))
        else:
            view = ProgressView(Console(file=io.StringIO()))
            execute_plan(
                one.plan(),
                root,
                ExecutionConfig(teachers=TeacherPlacement(where), poll_seconds=0.1),
                view=view,
            )
        results = Results.open(root)
        (attempt,) = results.table(Table.ATTEMPTS).to_pylist()
        return attempt["env_steps_per_second"], len(results.table(Table.EPISODES))


def exchange_milliseconds(episodes: int) -> dict[str, float]:
    """Return the median time of an exchange with a teacher in this process and in an actor, in ms."""
    connect(None)
    with tempfile.TemporaryDirectory() as place:
        (spec,) = campaign("ppo", STEPS["ppo"], Path(place)).plan().runs
    spec = replace(spec, teacher="random", teacher_hyperparameters={})
    medians = {}
    teachers: dict[str, TeacherLink] = {"process": InlineTeacher(spec), "actor": RemoteTeacher(spec)}
    for name, teacher in teachers.items():
        task, spent = teacher.exchange(None).task, []
        for index in range(episodes):
            assert task is not None, "this teacher has no queries"
            episode = Episode(task, 0.0, False, 500, np.zeros(24, dtype=np.float32), 0.0, 500 * index)
            start = time.perf_counter()
            task = teacher.exchange(episode).task
            spent.append(time.perf_counter() - start)
        medians[name] = 1e3 * statistics.median(spent)
    return medians


def main() -> None:
    """Measure the students with all three placements, in turn."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--students", nargs="+", choices=STEPS, default=list(STEPS))
    parser.add_argument("--steps", type=COUNT, help="of each run (ppo 100,000, sac 4,000)")
    parser.add_argument("--episodes", type=COUNT, default=2_000, help="exchanged with a teacher")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    places = ("process", TeacherPlacement.INLINE.value, TeacherPlacement.ACTOR.value)
    rows = []
    for student in options.students:
        steps = options.steps or STEPS[student]
        measured: dict[str, list[float]] = {place: [] for place in places}
        for _ in range(options.repeats):
            for place in places:
                speed, episodes = steps_per_second(student, steps, place)
                measured[place].append(speed)
        medians = {place: statistics.median(values) for place, values in measured.items()}
        seconds = {place: steps / medians[place] for place in places}
        rows.append(
            {
                "student": student,
                "episodes": episodes,
                "steps_per_second": medians,
                "ratio_seed_actor": medians["inline"] / medians["process"],
                "ratio_seed_and_teacher_actor": medians["actor"] / medians["process"],
                "seconds_of_teacher_actor": seconds["actor"] - seconds["inline"],
            }
        )
        print(json.dumps(rows[-1], indent=1))
    exchange = exchange_milliseconds(options.episodes)
    print(json.dumps({"exchange_milliseconds": exchange}))
    if options.output:
        content = {"machine": platform.machine(), "rows": rows, "exchange_milliseconds": exchange}
        options.output.write_text(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()

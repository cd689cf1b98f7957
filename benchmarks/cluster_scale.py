"""Scale of the driver: a campaign of simulated students on 64 CPUs, stopped half-way and resumed.

Prints JSON. The cluster has a head and four raylets of 16 CPUs; a few processes train the students of all
CPUs. Everything else is as in a campaign: the driver joins the cluster, and every run is started, polled,
published and finished, and writes its evaluations.

    python benchmarks/cluster_scale.py --runs 2000 --output cluster_scale.json
"""

from __future__ import annotations

import argparse
import io
import json
import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import psutil
import ray
from ray.cluster_utils import Cluster
from rich.console import Console
from scheduler import SETTINGS, Method, RayWithoutDeath, Substitute

from tma_ray.campaign.cluster.connection import connect
from tma_ray.campaign.cluster.protocols import Head
from tma_ray.campaign.executors import ray_executor
from tma_ray.campaign.progress import ProgressView, Snapshot
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.results import Committer, PartFile, RunWriter, Store, Table
from tma_ray.runs import Cell, RunSpec, Schedule, effective_spec
from tma_ray.tasks import KnowledgeLevel
from tma_ray.testing import find_simulated_challenge, simulate

RAYLETS, PLACES = 4, 16

TRAINERS = 8
"""Number of processes that train students."""

EPISODES = 60
"""Number of episodes of a run."""

WARM = 200
"""Number of finished runs before the first measurement of the driver's memory."""


class Trainer:
    """Actor that trains simulated students, one after the other."""

    def run(self, spec: dict[str, Any], store: Store, number: int) -> tuple[PartFile, ...]:
        """Return the result files of a run."""
        run = RunSpec.from_dict(spec)
        challenge = find_simulated_challenge("original")
        played = simulate(challenge, "random", KnowledgeLevel.NONE, run.seed, EPISODES)
        tests = challenge.tests()
        writer = RunWriter(store, run.run_id, number)
        for point, returns in enumerate(played.returns, start=1):
            rows = [
                {
                    "step": point,
                    "test_set": tests.name,
                    "task_index": index,
                    "task": task,
                    "episodic_return": value,
                    "length": 1,
                }
                for index, (task, value) in enumerate(zip(tests.tasks, returns, strict=True))
            ]
            writer.add(Table.EVALUATIONS, rows)
        return writer.finish()

    @ray.method(concurrency_group="reports")  # runs do not block it, as in seed actors
    def nothing(self) -> None:
        """Do nothing."""


RemoteTrainer: Any = ray.remote(concurrency_groups={"reports": 1})(Trainer)  # type: ignore[call-overload]


class Student(Substitute):
    """Substitute for a `SeedActor` that runs in the process of a trainer."""

    def __init__(self, spec: dict[str, Any], store: Store, number: int, *_: Any) -> None:
        trainer = self.trainers[Substitute.launched % len(self.trainers)]
        Substitute.launched += 1
        self.run = Method(trainer.run, spec, store, number)
        self.report = self.request_stop = Method(trainer.nothing)


class Driver:
    """Driver of a campaign, with measurements of its time and memory.

    Args:
        root: of the results.
        head: of the cluster.
    """

    def __init__(self, root: str, head: Head) -> None:
        self._root, self._head = root, head
        self._process = psutil.Process()

    def execute(
        self, runs: list[RunSpec], last: float = math.inf, done_before: int = 0
    ) -> tuple[Snapshot, dict[str, float]]:
        """Execute runs until `last` of them were started; return the final state and the measurements."""
        memory: list[tuple[int, int]] = []
        start, cpu, before = time.perf_counter(), self._process.cpu_times(), Substitute.launched
        first = 0.0

        def stop() -> bool:
            nonlocal first
            launched = Substitute.launched - before
            first = first or (time.perf_counter() - start if launched else 0.0)
            if not memory and launched >= WARM:
                memory.append((launched, self._process.memory_info().rss))
            return launched >= last

        view = ProgressView(Console(file=io.StringIO()))
        committer = Committer.open(self._root)
        executor = ray_executor.RayExecutor(committer.store, SETTINGS, self._head)
        ended = Scheduler(committer, executor, SETTINGS, view).execute(runs, stop)
        seconds, used = time.perf_counter() - start, self._process.cpu_times()
        memory.append((Substitute.launched - before, self._process.memory_info().rss))
        (early, low), (late, high) = memory[0], memory[-1]
        done = ended.done - done_before
        return ended, {
            "runs": done,
            "runs_per_minute": 60 * done / (seconds - first),
            "seconds_before_the_first_run": first,
            "driver_processor_milliseconds_per_run": 1e3 * sum(np.subtract(used[:2], cpu[:2])) / done,
            "driver_megabytes": high / 1e6,
            "driver_kilobytes_per_run": (high - low) / 1e3 / max(late - early, 1),
        }


def measure(count: int, root: str) -> dict[str, Any]:
    """Measure a campaign of `count` runs up to its half, and from there to its end."""
    cell = effective_spec(Cell(student="ppo", teacher="random"), 0, Schedule(steps=1))
    runs = [replace(cell, seed=seed) for seed in range(count)]
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    try:
        for _ in range(RAYLETS):
            cluster.add_node(num_cpus=PLACES, object_store_memory=100_000_000)
        head = connect(cluster.address).head
        Substitute.trainers = [RemoteTrainer.options(num_cpus=1).remote() for _ in range(TRAINERS)]
        ray.get([trainer.nothing.remote() for trainer in Substitute.trainers])
        driver = Driver(root, head)
        with (
            mock.patch.object(ray_executor, "SeedActor", Student),
            mock.patch.object(ray_executor, "ray", RayWithoutDeath()),
        ):
            half, first = driver.execute(runs, count // 2)
            ended, second = driver.execute(runs, done_before=half.done)
        assert ended.done == count, ended
        return {"places": RAYLETS * PLACES, "first_half": first, "resumed": second}
    finally:
        ray.shutdown()
        cluster.shutdown()  # type: ignore[no-untyped-call]


def main() -> None:
    """Measure a campaign, and print and write the results."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--runs", type=int, default=2000, help="of the campaign (%(default)s)")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as root:
        content = json.dumps(measure(options.runs, root), indent=1)
    print(content)
    if options.output:
        options.output.write_text(content)


if __name__ == "__main__":
    main()

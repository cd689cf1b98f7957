"""Overhead of the scheduler: thousands of empty runs in shared processes, and some in separate ones.

Prints JSON. In the first part a few actors share all runs: each run writes its empty tables, and the
scheduler starts, polls, publishes and finishes it as usual. In the second part every run has its own process;
compare it with a bare Ray actor, measured in the same run.

    python benchmarks/scheduler.py --runs 10000 --output scheduler.json
"""

from __future__ import annotations

import argparse
import io
import json
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import ray
from rich.console import Console

from tma_ray.campaign.cluster.connection import connect
from tma_ray.campaign.executors import ray_executor
from tma_ray.campaign.executors.actors import SeedActor
from tma_ray.campaign.progress import ProgressView
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.campaign.settings import ExecutionConfig, Resources, TeacherPlacement
from tma_ray.results import Committer, PartFile, RunWriter, Store
from tma_ray.runs import Cell, RunSpec, Schedule, effective_spec

TRAINERS = 2
SETTINGS = ExecutionConfig(
    resources=Resources(memory_gib=0.2), teachers=TeacherPlacement.INLINE, poll_seconds=0.1
)


class IdleTrainer:
    """Actor that executes runs without steps, one after the other."""

    def run(self, run_id: str, store: Store, number: int) -> tuple[PartFile, ...]:
        """Finish a run with empty tables; return its result files."""
        return RunWriter(store, run_id, number).finish()

    def nothing(self) -> None:
        """Do nothing."""


RemoteIdleTrainer: Any = ray.remote(IdleTrainer)


class Method:
    """Method of a seed actor, forwarded to an `IdleTrainer`."""

    def __init__(self, method: Any, *arguments: Any) -> None:
        self._method, self._arguments = method, arguments

    def remote(self) -> Any:
        """Call the method; return the reference of its result."""
        return self._method.remote(*self._arguments)


class Substitute:
    """Substitute for a `SeedActor` without a process."""

    trainers: list[Any] = []
    launched = 0

    def __init__(self, spec: dict[str, Any], store: Store, number: int, *_: Any) -> None:
        trainer = self.trainers[Substitute.launched % len(self.trainers)]
        Substitute.launched += 1
        self.run = Method(trainer.run, RunSpec.from_dict(spec).run_id, store, number)
        self.report = self.request_stop = Method(trainer.nothing)

    @classmethod
    def launch(cls, _resources: Resources, _avoid: Any, *arguments: Any) -> Substitute:
        """See `SeedActor.launch`."""
        return cls(*arguments)


class RayWithoutDeath:
    """Module `ray` with a `kill` that does nothing, since trainers are shared."""

    def __getattr__(self, name: str) -> Any:
        return getattr(ray, name)

    def kill(self, actor: Any) -> None:
        """Do nothing."""


def specs(count: int, steps: int) -> list[RunSpec]:
    """Return `count` runs with different seeds."""
    first = effective_spec(Cell(student="ppo", teacher="random"), 0, Schedule(steps=steps))
    return [replace(first, seed=seed) for seed in range(count)]


def execute(runs: list[RunSpec], root: str) -> dict[str, float]:
    """Execute runs; return the time and memory of the scheduler."""
    view = ProgressView(Console(file=io.StringIO()))
    start, used = time.perf_counter(), time.process_time()
    committer, head = Committer.open(root), connect(None).head
    executor = ray_executor.RayExecutor(committer.store, SETTINGS, head)
    ended = Scheduler(committer, executor, SETTINGS, view).execute(runs, lambda: False)
    seconds, used = time.perf_counter() - start, time.process_time() - used
    assert ended.done == len(runs)
    return {
        "runs": len(runs),
        "milliseconds_per_run": 1e3 * seconds / len(runs),
        "driver_processor_milliseconds_per_run": 1e3 * used / len(runs),
        "driver_megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }


def trivial(count: int) -> dict[str, Any]:
    """Return the overhead of `count` runs in shared processes, and of a second call that finds them done."""
    Substitute.trainers = [RemoteIdleTrainer.options(num_cpus=0).remote() for _ in range(TRAINERS)]
    runs = specs(count, 1)
    with (
        tempfile.TemporaryDirectory() as root,
        mock.patch.object(ray_executor, "SeedActor", Substitute),
        mock.patch.object(ray_executor, "ray", RayWithoutDeath()),
        mock.patch.object(ray_executor, "capacity", return_value=TRAINERS),
    ):
        first = execute(runs, root)
        again = execute(runs, root)
    return {**first, "milliseconds_per_run_when_all_are_done": again["milliseconds_per_run"]}


def bare_actor_milliseconds(count: int) -> float:
    """Return the mean time to start, call and kill a Ray actor that does nothing, in ms."""
    start = time.perf_counter()
    for _ in range(count):
        actor = RemoteIdleTrainer.options(num_cpus=1).remote()
        ray.get(actor.nothing.remote())
        ray.kill(actor)
    return 1e3 * (time.perf_counter() - start) / count


def main() -> None:
    """Measure runs in shared and in separate processes."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000, help="in shared processes (%(default)s)")
    parser.add_argument("--processes", type=int, default=20, help="runs in their own (%(default)s)")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    connect(None)
    content = {"shared_processes": trivial(options.runs)}
    print(json.dumps(content, indent=1), flush=True)
    with tempfile.TemporaryDirectory() as root:
        own = execute(specs(options.processes, 100), root)
    bare = bare_actor_milliseconds(options.processes)
    content["own_processes"] = {**own, "bare_actor_milliseconds": bare, "actor": SeedActor.__name__}
    print(json.dumps(content, indent=1))
    if options.output:
        options.output.write_text(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()

"""Processor time of a step of whole runs, alone and in a cohort, and its parts."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

import numpy as np
import psutil
from processes import LocalExecutor, cohort

from tma_ray.campaign.plan import CampaignSpec
from tma_ray.campaign.progress import Snapshot
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.campaign.settings import ExecutionConfig
from tma_ray.envs import make_environment
from tma_ray.results import Committer
from tma_ray.runs import Cell, Placement, RunSpec, Schedule
from tma_ray.runs.inputs import arguments
from tma_ray.students import Learner, Transition, make_rollout_worker
from tma_ray.students.rollout_workers import CohortSettings
from tma_ray.students.rollout_workers.link import ask_learner

EXPLORATION = {"sac": {"exploration_steps": 1000}}
"""Hyper-parameters with which students learn early."""

FIRST_STEPS = 2_000
"""Steps of each run before the measurement, after which all students learn."""

LONGER_THAN_MEASURED = 100_000_000
"""Budget and intervals of the runs, in environment steps, too long to be reached."""

WORKER = "acting", "environment", "collecting"
"""Parts of a rollout worker's step; collecting includes the exchange with the learner, but no waiting."""

LEARNER = "asking for updates", "requests", "deliveries", "waiting"
"""Parts of a learner's time."""

PLAYED = 6_000
"""Number of steps over which a rollout worker's parts are measured."""


def runs_of(student: str, count: int) -> list[RunSpec]:
    """Return `count` runs of a student under Random on the original space, with different seeds."""
    cell = Cell(student=student, teacher="random", student_hyperparameters=EXPLORATION.get(student, {}))
    schedule = Schedule(*[LONGER_THAN_MEASURED] * 3)
    return list(CampaignSpec("whole_runs", (cell,), tuple(range(count)), schedule).plan().runs)


@dataclass
class Meter:
    """Progress view that measures a pool of runs: steps and processor time.

    Attributes:
        runs: number of runs.
        seconds: duration of the measurement after all runs have begun to learn, s.
        learner: learner of the cohort; None if the runs learn alone.
        others: ids of processes other than runs, such as the learner.
        samples: wall time, processor times of runs and others in s, steps, and the learner's times by part.
    """

    runs: int
    seconds: float
    learner: Learner | None
    others: set[int]
    samples: list[tuple[float, float, float, int, dict[str, float]]] = field(default_factory=list)

    def update(self, snapshot: Snapshot) -> None:
        """Add a sample if all runs are learning."""
        steps = [run.status.step for run in snapshot.running]
        if len(steps) == self.runs and min(steps) > FIRST_STEPS:
            parts = ask_learner(self.learner, "account") if self.learner else {}
            used = _processor_seconds()
            learning = sum(seconds for pid, seconds in used.items() if pid in self.others)
            playing = sum(used.values()) - learning
            self.samples.append((time.monotonic(), playing, learning, sum(steps), parts))

    def close(self, snapshot: Snapshot) -> None:
        """Do nothing, since runs have ended."""

    def enough(self) -> bool:
        """Return True once the measurement is over."""
        return bool(self.samples) and self.samples[-1][0] - self.samples[0][0] > self.seconds

    def result(self) -> dict[str, float]:
        """Return the processor time per step, in µs, and the shares of the learner's time."""
        first, last = self.samples[0], self.samples[-1]
        seconds, playing, learning, steps = (b - a for a, b in zip(first[:4], last[:4], strict=True))
        shares = {part: (last[4][part] - first[4][part]) / seconds for part in LEARNER if last[4]}
        micro = 1e6 / max(steps, 1)
        return {"runs": micro * playing, "learner": micro * learning, **shares}


def _processor_seconds() -> dict[int, float]:
    """Return the processor time of all child processes by id, s."""
    found = {}
    for process in psutil.Process().children(recursive=True):
        try:
            times = process.cpu_times()
        except psutil.NoSuchProcess:
            continue
        found[process.pid] = times.user + times.system
    return found


@contextmanager
def _placed(width: int, device: str) -> Iterator[Placement]:
    """Context manager with a placement of runs: in a cohort, or alone if `width` is 0."""
    if not width:
        yield Placement(device)
        return
    with cohort(CohortSettings(device, width)) as learner:
        yield Placement(learner=learner)


def pool(student: str, count: int, width: int, device: str, seconds: float) -> dict[str, float]:
    """Execute runs for some time in parallel; return the result of `Meter`."""
    with ExitStack() as stack:
        root = stack.enter_context(tempfile.TemporaryDirectory())
        committer = Committer.open(root)
        placement = stack.enter_context(_placed(width, device))
        meter = Meter(count, seconds, placement.learner, set(_processor_seconds()))
        executor = LocalExecutor(committer.store, placement, count)
        Scheduler(committer, executor, ExecutionConfig(), meter).execute(
            runs_of(student, count), meter.enough
        )
        return meter.result()


def worker_parts(student: str, width: int, device: str) -> dict[str, float]:
    """Return the processor times of the parts of a rollout worker's step, in µs."""
    (spec,) = runs_of(student, 1)
    environment = make_environment(spec.environment, **arguments(spec, "environment"))
    spaces = environment.observation_space, environment.action_space
    spent = dict.fromkeys(WORKER, 0)
    with _placed(width, device) as placement:
        assert placement.learner is not None
        seed, values = np.random.SeedSequence(0), arguments(spec, "student")
        worker = make_rollout_worker(student, *spaces, seed, values, placement.learner)
        observation, _ = environment.reset(seed=0)
        for _ in range(PLAYED):
            clock = [time.process_time_ns()]
            action = worker.act(observation)
            clock.append(time.process_time_ns())
            following, reward, terminated, truncated, _ = environment.step(action)
            clock.append(time.process_time_ns())
            worker.observe(Transition(observation, action, float(reward), following, terminated, truncated))
            clock.append(time.process_time_ns())
            for part, before, after in zip(WORKER, clock, clock[1:], strict=False):
                spent[part] += after - before
            observation = environment.reset()[0] if terminated or truncated else following
    environment.close()
    return {part: nanoseconds / 1000 / PLAYED for part, nanoseconds in spent.items()}


def compare(student: str, width: int, device: str, seconds: float) -> dict[str, float | str]:
    """Return the cost of a step alone (on a CPU) and in a full cohort, and its parts."""
    alone = pool(student, width, 0, "cpu", seconds)
    together = pool(student, width, width, device, seconds)
    costs = {
        "alone, µs": alone["runs"],
        "rollout workers, µs": together["runs"],
        "learner, µs": together["learner"],
    }
    ratio = alone["runs"] / (together["runs"] + together["learner"])
    shares = {part: together[part] for part in LEARNER}
    parts = {f"{part}, µs": cost for part, cost in worker_parts(student, width, device).items()}
    return {"student": student, "width": width, **costs, "speed per core": ratio, **parts, **shares}


def table(rows: list[dict[str, float | str]]) -> str:
    """Return comparisons as a Markdown table."""
    lines = [f"| {' | '.join(rows[0])} |", f"|{' --- |' * len(rows[0])}"]
    for row in rows:
        cells = [f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row.values()]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)

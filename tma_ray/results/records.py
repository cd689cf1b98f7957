"""Records of runs and of attempts at them, as readers see them."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum


class RunStatus(StrEnum):
    """How far a run is, to readers."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class RunRecord:
    """What a run is: its row of the table of runs.

    Attributes:
        run_id: hash of the effective spec and seed.
        spec: the whole effective spec, JSON.
        environment: name of the environment.
        challenge: name of the variant of the environment.
        embodiment: name of the body.
        student: name of the deep-RL algorithm.
        teacher: name of the ACL algorithm.
        expert_knowledge: level of what the teacher was told and used.
        test_set: name of the test set of its evaluations.
        steps: budget, environment steps.
        seed: seed of the run.
        physics_version: version of the physics; 0 if the worlds were those of another engine.
        benchmark_version: version of the benchmark that the run was made with; 0 before there was one, and
            for other engines.
    """

    run_id: str
    spec: str
    environment: str
    challenge: str
    embodiment: str
    student: str
    teacher: str
    expert_knowledge: str
    test_set: str
    steps: int
    seed: int
    physics_version: int
    benchmark_version: int = 0


class AttemptOutcome(StrEnum):
    """How an attempt at a run ended."""

    DONE = "done"
    STOPPED = "stopped"
    """It was asked to stop, and left a checkpoint."""
    FAILED = "failed"
    """An exception of its own."""
    LOST = "lost"
    """Its process or machine died."""


@dataclass(frozen=True)
class AttemptRecord:
    """One attempt at a run.

    Attributes:
        run_id: of the run.
        attempt: its number, from 0.
        started_at: when it began, with a time zone.
        wall_seconds: how long it took, set-up included, s.
        env_steps_per_second: environment steps over the time of the loop, set-up left out, 1/s.
        host: where it ran.
        fingerprint: of the CPU model, thread count and library versions, JSON.
        outcome: how it ended.
    """

    run_id: str
    attempt: int
    started_at: datetime
    wall_seconds: float
    env_steps_per_second: float
    host: str
    fingerprint: str
    outcome: AttemptOutcome

    def __post_init__(self) -> None:
        if self.started_at.tzinfo is None:
            raise ValueError(f"started_at {self.started_at} has no time zone; use datetime.now(UTC)")

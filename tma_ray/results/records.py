"""Records of runs, attempts and trials."""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Any, Final

from tma_ray.results.storage import Store
from tma_ray.support.decoding import Natural, SmallNatural, decode_json
from tma_ray.tasks import MASTERY_RETURN

HASHED_ID: Final = re.compile(r".*-s\d+-([0-9a-f]{12})")
"""Pattern of run ids, which end in the digest of the spec."""


class RunStatus(StrEnum):
    """Status of a run."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class RunRecord:
    """Row of the table of runs.

    Attributes:
        run_id: hash of the effective spec and seed.
        spec: effective spec, JSON.
        expert_knowledge: level of expert knowledge that the teacher had and used.
        test_set: name of the test set.
        steps: budget, environment steps.
        physics_version: version of the physics, 0 for other engines.
        benchmark_version: version of the benchmark, 0 for older runs and other engines.
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
    steps: Natural
    seed: Natural
    physics_version: SmallNatural
    benchmark_version: SmallNatural = 0


class AttemptOutcome(StrEnum):
    """Outcome of an attempt at a run."""

    DONE = "done"
    STOPPED = "stopped"  # ended on request, with a checkpoint
    FAILED = "failed"  # ended by an exception
    LOST = "lost"  # ended by the loss of its process or machine


@dataclass(frozen=True)
class AttemptRecord:
    """Record of one attempt at a run.

    Attributes:
        attempt: number of the attempt, from 0.
        started_at: start time, with a time zone.
        wall_seconds: duration, including set-up, s.
        env_steps_per_second: environment steps per second of the loop, without set-up, 1/s.
        fingerprint: CPU model, vector extensions, thread count and library versions, JSON.
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


@dataclass(frozen=True)
class ScheduleView:
    """Budget in environment steps, the only field of a spec's schedule that readers use."""

    steps: Natural | None = None


@dataclass(frozen=True)
class SpecView:
    """Fields of a spec that readers use; None or empty if missing."""

    engine: str | None = None  # physics engine of imported runs
    environment: str | None = None
    challenge: str | None = None
    student: str | None = None
    teacher: str | None = None
    seed: Natural | None = None
    mastery_threshold: float | None = None
    schedule: ScheduleView = field(default_factory=ScheduleView)
    plugins: Mapping[str, Any] = field(default_factory=dict)
    task_space: tuple[Mapping[str, str | float], ...] = ()
    environment_options: Mapping[str, Any] = field(default_factory=dict)
    student_hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    teacher_hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    test_set: Mapping[str, Any] = field(default_factory=dict)


def spec_digest(spec: str) -> str:
    """Return the SHA-256 of a spec (JSON with sorted keys), whose first digits end the run id."""
    return hashlib.sha256(spec.encode()).hexdigest()


def mastery_threshold(run: RunRecord) -> float:
    """Return the episodic return above which a task counts as mastered in a run."""
    threshold = decode_json(run.spec, SpecView, f"the spec of run {run.run_id}").mastery_threshold
    return MASTERY_RETURN if threshold is None else threshold


def check_spec(run: RunRecord) -> None:
    """Raise a ValueError if the spec in a record does not match the record's id or columns.

    Ids of imported runs hash source files instead, and are not checked.
    """
    spec = decode_json(run.spec, SpecView, f"the spec of run {run.run_id}")
    match = HASHED_ID.fullmatch(run.run_id)
    if match and spec.engine is None and not spec_digest(run.spec).startswith(match[1]):
        raise ValueError(f"its spec does not hash to the end of the run's id, {run.run_id}")
    fields = {
        name: getattr(spec, name) for name in ("environment", "challenge", "student", "teacher", "seed")
    }
    fields["steps"] = spec.schedule.steps
    for name, value in fields.items():
        if value is not None and value != getattr(run, name):
            raise ValueError(f"its {name} is {getattr(run, name)!r}, but its spec says {value!r}")


CHIPMUNK: Final = "Chipmunk"  # engine of tma_ray, the default of specs without one
BOX2D: Final = "Box2D"  # engine of the original release
SIMULATED: Final = "Simulated students"  # pseudo-engine of students without physics
NO_PHYSICS_VERSION: Final = 0  # physics version of runs with other engines
BOX2D_TEST_SET: Final = "box2d_"  # prefix of the names of test sets for Box2D worlds

TRIAL_FILE: Final = "trial.json"


@dataclass(frozen=True)
class TrialLook:
    """Interim look of a trial: the number of seeds per cell, and the verdicts as a sentence."""

    seeds: Natural
    said: str


@dataclass(frozen=True)
class TrialFile:
    """Design, interim looks and end of a trial, as stored in `TRIAL_FILE`.

    Attributes:
        design: design of the trial, fixed beforehand.
        looks: interim looks so far.
        ended: reason of its end, empty before.
        format: format of the file.
    """

    design: Mapping[str, Any]
    looks: tuple[TrialLook, ...] = ()
    ended: str = ""
    format: str = "tma_ray trial"

    @classmethod
    def load(cls, store: Store) -> "TrialFile | None":
        """Return the trial of a root, or None if it has none."""
        if not store.holds(TRIAL_FILE):
            return None
        return store.read_json(TRIAL_FILE, cls)

    def save(self, store: Store) -> None:
        """Write the trial to a root."""
        store.write_bytes(TRIAL_FILE, (json.dumps(asdict(self), indent=1) + "\n").encode())

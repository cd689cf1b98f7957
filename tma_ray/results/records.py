"""Records of runs and of attempts at them, as readers see them."""

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
"""An id that `run_id` of a spec has made: its end is the spec's `digest`."""


class RunStatus(StrEnum):
    """Status of a run, to readers."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class RunRecord:
    """Description of a run: its row of the table of runs.

    Attributes:
        run_id: hash of the effective spec and seed.
        spec: the whole effective spec, JSON.
        environment: name of the environment.
        challenge: name of the variant of the environment.
        embodiment: name of the body.
        student: name of the deep-RL algorithm.
        teacher: name of the ACL algorithm.
        expert_knowledge: level of expert knowledge that the teacher had and used.
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
    steps: Natural
    seed: Natural
    physics_version: SmallNatural
    benchmark_version: SmallNatural = 0


class AttemptOutcome(StrEnum):
    """Outcome of an attempt at a run."""

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
        run_id: id of the run.
        attempt: number of the attempt, from 0.
        started_at: time of its start, with a time zone.
        wall_seconds: duration, set-up included, s.
        env_steps_per_second: environment steps over the time of the loop, set-up left out, 1/s.
        host: name of its machine.
        fingerprint: CPU model, vector extensions, thread count and library versions, as JSON.
        outcome: outcome of the attempt.
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
    """Training budget of a spec's schedule, environment steps: what readers use of it."""

    steps: Natural | None = None


@dataclass(frozen=True)
class SpecView:
    """Facts of a run's spec that readers use; None or empty where the spec does not say.

    Attributes:
        engine: simulator of the worlds, of imported runs.
        environment: name of the environment.
        challenge: name of the variant of the environment.
        student: name of the deep-RL algorithm.
        teacher: name of the ACL algorithm.
        seed: seed of the run.
        mastery_threshold: episodic return over which a task is mastered.
        schedule: its budget.
        plugins: sources of what does not ship with tma_ray, by part of the run.
        task_space: dimensions of what the teacher chooses from.
        environment_options: options of the environment, the embodiment among them.
        student_hyperparameters: hyper-parameters of the student.
        teacher_hyperparameters: hyper-parameters of the teacher.
        test_set: the evaluation tasks.
    """

    engine: str | None = None
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
    """Return the hash of a spec, JSON with sorted keys, of which the end of its run's id is made."""
    return hashlib.sha256(spec.encode()).hexdigest()


def mastery_threshold(run: RunRecord) -> float:
    """Return the episodic return over which a task is mastered in a run, also where its spec names none."""
    threshold = decode_json(run.spec, SpecView, f"the spec of run {run.run_id}").mastery_threshold
    return MASTERY_RETURN if threshold is None else threshold


def check_spec(run: RunRecord) -> None:
    """Refuse a record whose spec is not that of its id, or says something else than its columns.

    Ids of imported runs are hashes of their source files instead, and are not compared.

    Raises:
        ValueError: the message names the field.
    """
    facts = decode_json(run.spec, SpecView, f"the spec of run {run.run_id}")
    hashed = HASHED_ID.fullmatch(run.run_id)
    if hashed and facts.engine is None and not spec_digest(run.spec).startswith(hashed[1]):
        raise ValueError(f"its spec does not hash to the end of the run's id, {run.run_id}")
    told = {name: getattr(facts, name) for name in ("environment", "challenge", "student", "teacher", "seed")}
    told["steps"] = facts.schedule.steps
    for name, value in told.items():
        if value is not None and value != getattr(run, name):
            raise ValueError(f"its {name} is {getattr(run, name)!r}, but its spec says {value!r}")


CHIPMUNK: Final = "Chipmunk"
"""Simulates the worlds of tma_ray; a run whose spec names no engine is one of its."""

BOX2D: Final = "Box2D"
"""Simulated the worlds of the original release."""

SIMULATED: Final = "Simulated students"
"""Stands for the equations of students without physics."""

NO_PHYSICS_VERSION: Final = 0
"""Physics version of runs of other engines; those of tma_ray count from 1."""

BOX2D_TEST_SET: Final = "box2d_"
"""Before the name of a test set whose worlds were Box2D's."""


TRIAL_FILE: Final = "trial.json"


@dataclass(frozen=True)
class TrialLook:
    """A look at a trial.

    Attributes:
        seeds: number of seeds of every cell.
        said: verdicts in a sentence.
    """

    seeds: Natural
    said: str


@dataclass(frozen=True)
class TrialFile:
    """The content of `TRIAL_FILE`.

    Attributes:
        design: design that was fixed beforehand.
        looks: looks so far.
        ended: why it ended; empty while it goes on.
        format: kind of the file.
    """

    design: Mapping[str, Any]
    looks: tuple[TrialLook, ...] = ()
    ended: str = ""
    format: str = "tma_ray trial"

    @classmethod
    def load(cls, store: Store) -> "TrialFile | None":
        """Return the trial of a root, None if it has none.

        Raises:
            DamagedFileError: it is not what was written.
        """
        if not store.holds(TRIAL_FILE):
            return None
        return store.read_json(TRIAL_FILE, cls)

    def save(self, store: Store) -> None:
        """Write it in one piece."""
        store.write_bytes(TRIAL_FILE, (json.dumps(asdict(self), indent=1) + "\n").encode())

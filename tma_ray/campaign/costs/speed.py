"""Measured speed of runs on this machine."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
from gymnasium import Space

from tma_ray.campaign.settings import Settings
from tma_ray.envs import make_environment
from tma_ray.part_names import base_name
from tma_ray.runs.evaluation import Evaluation
from tma_ray.runs.inputs import arguments
from tma_ray.runs.spec import RunSpec
from tma_ray.students import Student, Transition, make_student
from tma_ray.tasks import Task

WARM_UP_SECONDS = 0.3
"""Trained before a measurement, in whole updates, so that nothing is compiled or loaded in it, s."""

MEASURED_SECONDS = 0.6
"""Shortest measurement, s."""

EXPLORATION = {"exploration_steps": 1_000, "learning_starts": 1_000}
"""What students call the steps before their first update, and how many a measurement leaves them at most."""

SCHEDULE = {"updates": "interleaved"}
"""What students call the time of their updates, and the one that spreads as many over all steps: a
measurement is much shorter than what a long episode may owe at its end."""

STORAGE = {"buffer_size": 50_000}
"""What students call the size of their replay buffer, and what a measurement leaves of it at most."""

Clock = Callable[[], float]
"""Tells the time, s."""

CHUNKS = ("steps_per_update", "n_steps", "train_freq")
"""What students call the steps from one update to the next, which are measured whole."""


class Source(StrEnum):
    """Origin of a speed."""

    MEASURED = "measured"
    """Measured here and now."""
    REMEMBERED = "remembered"
    """Measured here before, with the same versions."""
    SHIPPED = "shipped"
    """Measured on another machine; nothing of that kind has been measured here yet."""


@dataclass(frozen=True)
class Throughput:
    """Speed of one kind of run, with as many runs at once as the machine holds.

    Attributes:
        label: student, environment and body.
        training: environment steps per second of training; in a cohort of a player on a core of its own,
            without waiting for the learner.
        playing: environment steps per second of an evaluation.
        transition_bytes: of one transition in a replay buffer.
        source: where the speed is from.
        measured_on: day of a remembered measurement, as 2026-01-31; empty otherwise.
        learner: environment steps per second that the learner of a full cohort feeds; 0 of runs that learn
            alone.
    """

    label: str
    training: float
    playing: float
    transition_bytes: int
    source: Source = Source.MEASURED
    measured_on: str = ""
    learner: float = 0.0


def label_of(spec: RunSpec) -> str:
    """Returns student, environment and body of a run, as costs show them."""
    return f"{spec.student} on {spec.environment} {spec.embodiment}".strip()


def measure(spec: RunSpec, settings: Settings) -> Throughput:
    """Returns how fast runs like `spec` are here: on one task, without a teacher; takes about two seconds.

    Everything is played before it is timed, so that nothing is compiled in a measurement. Time is that of
    the processor, which other processes slow down only as far as they share its caches and cores' halves.
    """
    environment = make_environment(spec.environment, **arguments(spec, "environment"))
    observation, action = environment.observation_space, environment.action_space
    values = arguments(spec, "student")
    values |= {
        name: min(values[name], most) for name, most in (EXPLORATION | STORAGE).items() if name in values
    }
    values |= {name: value for name, value in SCHEDULE.items() if name in values}
    seed, resources = np.random.SeedSequence(0), settings.resources
    student = make_student(
        base_name(spec.student), observation, action, seed, values, settings.device, resources.threads
    )
    player = TrainingLoop(environment, student, spec)
    chunk = next((int(values[name]) for name in CHUNKS if isinstance(values.get(name), int)), 100)
    clock = _clock(settings)
    player.train(max(EXPLORATION.values()))
    speed_of(player.train, chunk, WARM_UP_SECONDS, clock)
    training = speed_of(player.train, chunk, MEASURED_SECONDS, clock)
    environment.close()
    playing = evaluation_speed(spec, student, clock)
    return Throughput(label_of(spec), training, playing, bytes_of_transition(observation, action))


def bytes_of_transition(observations: Space[Any], actions: Space[Any]) -> int:
    """Returns the size of a transition in a replay buffer, whose observations are stored once."""
    return 4 * (math.prod(observations.shape or ()) + math.prod(actions.shape or ()) + 2)


class TrainingLoop:
    """A student in an environment, on the middle task."""

    def __init__(self, environment: Any, student: Student, spec: RunSpec) -> None:
        self._environment, self._student = environment, student
        self._options = {"task": spec.task_space.centre}
        self._observation = environment.reset(seed=0, options=self._options)[0]

    def train(self, steps: int) -> None:
        """Goes on learning for `steps` steps."""
        for _ in range(steps):
            observation, action = self._observation, self._student.act(self._observation)
            following, reward, terminated, truncated, _ = self._environment.step(action)
            self._student.observe(
                Transition(observation, action, float(reward), following, terminated, truncated)
            )
            self._go_on(following, terminated or truncated)

    def _go_on(self, following: Any, ended: bool) -> None:
        self._observation = self._environment.reset(options=self._options)[0] if ended else following


def _clock(settings: Settings) -> Clock:
    """Returns the processor's time per thread, s, which other load leaves alone; with a GPU the wall's."""
    threads = settings.resources.threads
    return (lambda: time.process_time() / threads) if settings.device == "cpu" else time.perf_counter


def speed_of(play: Callable[[int], None], chunk: int, seconds: float, clock: Clock) -> float:
    """Returns steps per second of `play`, over whole chunks that take at least `seconds` together."""
    start, steps = clock(), 0
    while clock() - start < seconds:
        play(chunk)
        steps += chunk
    return steps / (clock() - start)


def evaluation_speed(spec: RunSpec, student: Student, clock: Clock) -> float:
    """Returns steps per second of `student` on every tenth test task, having played one before."""
    _play(spec, student, spec.test_set.tasks[:1], clock)
    steps, seconds = _play(spec, student, spec.test_set.tasks[::10], clock)
    return steps / seconds


def _play(spec: RunSpec, student: Student, tasks: Task, clock: Clock) -> tuple[int, float]:
    """Returns how many steps an evaluation on `tasks` takes, and its seconds."""
    evaluation = Evaluation(replace(spec, test_set=replace(spec.test_set, tasks=tasks)))
    start = clock()
    steps = int(sum(row["length"] for row in evaluation(student)))
    seconds = clock() - start
    evaluation.close()
    return steps, seconds

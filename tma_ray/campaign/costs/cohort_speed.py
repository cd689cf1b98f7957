"""Measured speed of the two halves of a cohort: a player, on a core of its own, and the learner of all."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from tma_ray.campaign.costs.speed import (
    EXPLORATION,
    MEASURED_SECONDS,
    STORAGE,
    Source,
    Throughput,
    TrainingLoop,
    bytes_of_transition,
    evaluation_speed,
    label_of,
    speed_of,
)
from tma_ray.campaign.settings import Settings
from tma_ray.envs import make_environment
from tma_ray.part_names import base_name
from tma_ray.runs.inputs import arguments
from tma_ray.runs.placement import is_available
from tma_ray.runs.spec import RunSpec
from tma_ray.students import check_hyperparameters
from tma_ray.students.base import checked_spaces
from tma_ray.students.players import CohortSettings, Membership, player_class

LEARNERS = {
    ("sac", "highest"): 41_500.0,
    ("sac", "high"): 63_700.0,
    ("sac", "medium"): 72_900.0,
    ("ppo", "highest"): 152_000.0,
}
"""Environment steps per second that a full learner of 48 slots feeds on an H100, by student and precision,
with updates captured and not compiled (benchmarks/README.md): for plans on a machine without a GPU."""

FEW_UPDATES = 2
"""Updates of a full stack between two looks at the clock."""


def measure_cohort(spec: RunSpec, settings: Settings) -> Throughput:
    """Returns how fast players like those of `spec`, and their learner, are here; see `speed.measure`.

    The learner is measured with full slots and updates that are not compiled, which on a GPU would take
    longer than the measurement. Without the device, its speed is that of `LEARNERS`, whose source is shipped.

    Raises:
        ValueError: nothing is known of such a learner, and the device is not here.
    """
    environment = make_environment(spec.environment, **arguments(spec, "environment"))
    spaces = checked_spaces(environment.observation_space, environment.action_space)
    name, values = base_name(spec.student), arguments(spec, "student")
    values |= {key: min(values[key], most) for key, most in (EXPLORATION | STORAGE).items() if key in values}
    membership = Membership(name, *spaces, check_hyperparameters(name, values), np.random.SeedSequence(0))
    here = is_available(settings.device)
    recorder = _Recorder(CohortSettings(settings.device, settings.width) if here else CohortSettings(width=1))
    player_type: Any = player_class(name)  # the recorder is as much of a link as is needed here
    player = player_type(membership, recorder)
    loop = TrainingLoop(environment, player, spec)
    loop.train(3 * max(EXPLORATION.values()))
    training = speed_of(loop.train, 500, MEASURED_SECONDS, time.process_time)
    environment.close()
    playing = evaluation_speed(spec, player, time.process_time)
    learner = recorder.speed() if here else _known(name, values)
    source = Source.MEASURED if here else Source.SHIPPED
    size = bytes_of_transition(*spaces)
    return Throughput(label_of(spec), training, playing, size, source, learner=learner)


def _known(student: str, values: dict[str, Any]) -> float:
    key = student, str(values.get("matmul_precision", "highest"))
    if key not in LEARNERS:
        raise ValueError(f"no GPU is here, and of {' with precision '.join(key)} no GPU's speed is known")
    return LEARNERS[key]


class _Recorder:
    """The link of a player whose weights stay as they are; keeps what it hands over, for the learner."""

    def __init__(self, settings: CohortSettings) -> None:
        from tma_ray.students.cohort.seats import Stacks

        self._stacks = Stacks(settings)
        self._experience: tuple[Any, ...] = ()
        self._updates = 0

    def join(self, membership: Membership) -> Any:
        """Takes a slot; see `LearnerLink`."""
        self._membership = membership
        self._seats = [self._stacks.seat(membership)]
        self._weights = self._seats[0].weights()
        return self._weights

    def learn(self, experience: tuple[Any, ...], updates: int) -> Any:
        """Keeps the experience; see `LearnerLink`."""
        if not updates:
            return None
        self._experience, self._updates = experience, updates
        return self._weights

    def speed(self) -> float:
        """Returns the environment steps per second that the learner feeds with all its slots full."""
        width, steps = self._stacks.settings.width, len(self._experience[1])
        self._seats += [self._stacks.seat(self._membership) for _ in range(width - len(self._seats))]
        stack = self._seats[0].stack
        for seat in self._seats:
            seat.learn(self._experience, self._updates)
        stack.advance(FEW_UPDATES)
        self._wait()
        began, updates = time.perf_counter(), 0
        while time.perf_counter() - began < MEASURED_SECONDS and stack.owed.max():
            updates += min(FEW_UPDATES, int(stack.owed.max()))
            stack.advance(FEW_UPDATES)
            self._wait()
        updating = self._updates * (time.perf_counter() - began) / max(updates, 1)
        stack.advance(self._updates)
        began = time.perf_counter()
        for seat in self._seats:
            seat.learn(self._experience, self._updates)
        stack.actors(range(width)).cpu()
        return width * steps / (updating + time.perf_counter() - began)

    def _wait(self) -> None:
        """Waits for what a GPU was asked to do."""
        import torch

        if torch.device(self._stacks.settings.device).type == "cuda":
            torch.cuda.synchronize()

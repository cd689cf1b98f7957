"""Episodes from which the student does not learn: proposed so by a teacher, or of an evaluation."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tma_ray.envs import make_environment
from tma_ray.envs.lock_step import LockStep, lock_step
from tma_ray.runs.inputs import arguments
from tma_ray.runs.playing.evaluation import Act, Environment, played_episodes
from tma_ray.runs.spec import RunSpec
from tma_ray.students import Student
from tma_ray.tasks import Outcomes, Task

WORLDS = 64
"""Most tasks of an evaluation that are played at the same time."""


class Trials:
    """Plays without learning, with randomness of its own, so that nothing of the student changes.

    An evaluation's worlds and the noise of its actions are new each time. What it gives depends on the state
    of the student and on what was drawn before; nothing else is kept between two evaluations.

    Args:
        spec: of the run.
        seed: source of all randomness.
    """

    def __init__(
        self,
        spec: RunSpec,
        seed: np.random.SeedSequence,
        make: Callable[..., Environment] = make_environment,
    ) -> None:
        self._spec, self._make = spec, make
        self._rng = np.random.default_rng(seed)
        self._environments: list[Environment] = []
        self._worlds: LockStep | None = None

    @property
    def state(self) -> dict[str, Any]:
        """State of the generator; between two episodes it is all that there is."""
        return dict(self._rng.bit_generator.state)

    @state.setter
    def state(self, state: dict[str, Any]) -> None:
        self._rng.bit_generator.state = state

    def act(self, student: Student, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Returns an action (a,) of the exploring policy for `observation` (o,)."""
        action: NDArray[np.float32] = student.sample_actions(observation[None], self._rng)[0]
        return action

    def evaluate(self, student: Student, tasks: Task, greedy: bool, budget: int) -> Outcomes | None:
        """Plays an episode of each task.

        Args:
            student: who plays.
            tasks: as the world builds them (n, d).
            greedy: by the deterministic policy instead of the exploring one.
            budget: steps left of the run.

        Returns:
            The outcomes; None if the budget ends before, or with, the last step.
        """
        act = student.act_greedily if greedy else partial(student.sample_actions, rng=self._rng)
        seeds = self._rng.integers(2**31, size=len(tasks)).tolist()
        parts = []
        for first in range(0, len(tasks), WORLDS):
            rows = slice(first, first + WORLDS)
            parts.append(self._play(seeds[rows], tasks[rows], act, budget))
            budget -= int(parts[-1][1].sum())
            if budget <= 0:
                return None
        episodic_returns, lengths = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Outcomes(episodic_returns, episodic_returns > self._spec.mastery_threshold, lengths)

    def close(self) -> None:
        """Closes all worlds."""
        for environment in self._environments:
            environment.close()

    def _play(
        self, seeds: list[int], tasks: Task, act: Act, budget: int
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        if self._worlds is None or len(tasks) > len(self._environments):
            self.close()
            options = arguments(self._spec, "environment")
            self._environments = [self._make(self._spec.environment, **options) for _ in tasks]
            self._worlds = lock_step(self._environments)
        return played_episodes(self._worlds, seeds, tasks, act, budget)

"""The steps of an episode, for teachers that ask for them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tma_ray.students import Transition
from tma_ray.tasks import Trajectory


class Recorder:
    """Collects one episode; copies, since an environment may reuse its arrays.

    Args:
        initial_observation: what `reset` gave (o,).
        gamma: the student's discount factor.
    """

    def __init__(self, initial_observation: NDArray[np.float32], gamma: float) -> None:
        self._gamma = gamma
        self._observations = [initial_observation.copy()]
        self._actions: list[NDArray[np.float32]] = []
        self._rewards: list[float] = []
        self._terminated = False

    def add(self, step: Transition) -> None:
        """Appends a step."""
        self._observations.append(step.next_observation.copy())
        self._actions.append(step.action.copy())
        self._rewards.append(step.reward)
        self._terminated = step.terminated

    def trajectory(self) -> Trajectory:
        """Returns the steps so far, at least one."""
        return Trajectory(
            observations=np.stack(self._observations).astype(np.float32, copy=False),
            actions=np.stack(self._actions).astype(np.float32, copy=False),
            rewards=np.array(self._rewards, dtype=np.float64),
            terminated=self._terminated,
            gamma=self._gamma,
        )

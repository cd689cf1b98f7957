"""Recording of the steps of an episode."""

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks.episodes import Trajectory


class Recorder:
    """Recorder of one episode; actions are copied, since a student may reuse its arrays.

    Args:
        initial_observation: observation of `reset` (o,).
        gamma: the student's discount factor.
    """

    def __init__(self, initial_observation: NDArray[np.float32], gamma: float) -> None:
        self._gamma = gamma
        self._observations = [initial_observation]
        self._actions: list[NDArray[np.float32]] = []
        self._rewards: list[float] = []
        self._terminated = False

    def add(
        self,
        action: NDArray[np.float32],
        reward: float,
        next_observation: NDArray[np.float32],
        terminated: bool,
    ) -> None:
        """Append a step."""
        self._observations.append(next_observation)
        self._actions.append(action.copy())
        self._rewards.append(reward)
        self._terminated = terminated

    def trajectory(self) -> Trajectory:
        """Return the steps so far, at least one."""
        return Trajectory(
            observations=np.stack(self._observations).astype(np.float32, copy=False),
            actions=np.stack(self._actions).astype(np.float32, copy=False),
            rewards=np.array(self._rewards, dtype=np.float64),
            terminated=self._terminated,
            gamma=self._gamma,
        )

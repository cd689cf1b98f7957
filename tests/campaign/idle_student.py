"""Student without torch, for campaigns in which nothing has to be learned."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np

from tma_ray.students import Student


@dataclass(frozen=True)
class Nothing:
    """Empty set of hyper-parameters."""


class Idle(Student):
    """Student with zero actions and no learning."""

    hyperparameters_type = Nothing
    gamma = 1.0

    def __init__(
        self, observation_space: gymnasium.Space, action_space: gymnasium.Space, *others: object
    ) -> None:
        self.size = action_space.shape[0]

    def act(self, observation: np.ndarray) -> np.ndarray:
        return self.act_greedily(observation[None])[0]

    def act_greedily(self, observations: np.ndarray) -> np.ndarray:
        return np.zeros((len(observations), self.size), np.float32)

    def state_values(self, observations: np.ndarray) -> np.ndarray:
        return np.zeros(len(observations))

    def observe(self, transition: object) -> None: ...
    def reset(self) -> None: ...

    def save(self, folder: Path, incremental: bool = False) -> tuple[str, ...]:
        return ()

    def load(self, folder: Path) -> None: ...
    def save_policy(self, folder: Path) -> None: ...

    @classmethod
    def load_policy(cls, folder: Path, device: str = "cpu") -> None: ...

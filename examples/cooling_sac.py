"""Example of a student: an algorithm derived from one of stable-baselines3."""

from typing import Any

import torch
from stable_baselines3 import SAC

from tma_ray.students.sb3.algorithms import as_student


class Cooling(SAC):
    """Soft actor-critic that explores less and less: its entropy coefficient halves again and again.

    All keywords of its constructor are hyper-parameters of the student: its own and those of SAC.

    Args:
        policy: argument of `SAC`.
        env: argument of `SAC`.
        ent_coef: entropy coefficient at the start.
        half_life: number of updates that halve the coefficient.
        others: other arguments of `SAC`.
    """

    def __init__(
        self, policy: Any, env: Any, *, ent_coef: float = 0.2, half_life: int = 5_000, **others: Any
    ) -> None:
        super().__init__(policy, env, ent_coef=ent_coef, **others)
        self.half_life = half_life

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Update the networks with the present entropy coefficient."""
        coefficient = self.ent_coef * 0.5 ** (self._n_updates / self.half_life)
        self.ent_coef_tensor = torch.tensor(coefficient, device=self.device)
        super().train(gradient_steps, batch_size)


CoolingSAC = as_student(Cooling)

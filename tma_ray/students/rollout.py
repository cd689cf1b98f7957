"""The steps between two PPO updates, with their returns and advantages. Imports torch for batches only."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tma_ray.jit import kernel
from tma_ray.students.base import Actions, Observations

if TYPE_CHECKING:
    import torch
    from stable_baselines3.common.type_aliases import RolloutBufferSamples

Judgement: TypeAlias = tuple[float, float]
"""What the networks say of a step: value of its observation, log probability of its action."""


class Rollout:
    """A fixed number of consecutive steps, and what the networks say of them when all are there.

    It stands in for stable-baselines3's rollout buffer, whose update reads `values`, `returns` and the
    batches of `get`. Returns and advantages equal its own to the last bit; shuffling draws from the
    generator given here instead of numpy's global one.

    Args:
        steps: number of steps n.
        observation_size: length o of an observation.
        action_size: length a of an action.
        generator: shuffles the mini-batches.
        device: where mini-batches go.
    """

    def __init__(
        self,
        steps: int,
        observation_size: int,
        action_size: int,
        generator: np.random.Generator,
        device: torch.device | None = None,
    ) -> None:
        self._generator = generator
        self._device = device
        self.observations = np.zeros((steps, observation_size), dtype=np.float32)
        self.actions = np.zeros((steps, action_size), dtype=np.float32)
        self.rewards = np.zeros(steps, dtype=np.float32)
        self.ended = np.zeros(steps, dtype=np.bool_)
        self.values = np.zeros(steps, dtype=np.float32)
        self.log_probabilities = np.zeros(steps, dtype=np.float32)
        self.advantages = np.zeros(steps, dtype=np.float32)
        self.returns = np.zeros(steps, dtype=np.float32)
        self._size = 0

    @property
    def is_full(self) -> bool:
        """True if an update is due."""
        return self._size == len(self.rewards)

    def clear(self) -> None:
        """Forgets all steps."""
        self._size = 0

    def add(
        self,
        observation: Observations,
        action: Actions,
        reward: float,
        ended: bool,
        judged: Judgement,
    ) -> None:
        """Appends a step.

        Args:
            observation: as the networks saw it, normalised (o,).
            action: as sampled, not clipped to the action space (a,).
            reward: normalised; the value of what a time limit cut off is part of it.
            ended: the episode ended with this step, by itself or by a time limit.
            judged: value of the observation, in normalised reward, and log probability of the action.
        """
        index = self._size
        self.observations[index] = observation
        self.actions[index] = action
        self.rewards[index] = reward
        self.ended[index] = ended
        self.values[index], self.log_probabilities[index] = judged
        self._size = index + 1

    def finish(self, last_value: float, gamma: float, gae_lambda: float) -> None:
        """Computes returns and advantages (generalised advantage estimation, arXiv:1506.02438).

        Args:
            last_value: value of the observation after the last step.
            gamma: discount factor.
            gae_lambda: lambda of the estimator.
        """
        goes_on = 1 - self.ended.astype(np.float32)
        next_values = np.append(self.values[1:], np.float32(last_value))
        errors = self.rewards + gamma * next_values * goes_on - self.values
        decays = gamma * gae_lambda * goes_on
        _discounted_sums(errors, decays, self.advantages)
        self.returns = self.advantages + self.values

    def get(self, batch_size: int | None = None) -> Iterator[RolloutBufferSamples]:
        """Yields all steps once, shuffled, in mini-batches of tensors; without a size, in a single one."""
        import torch
        from stable_baselines3.common.type_aliases import RolloutBufferSamples

        order, columns = self.shuffled(), self.columns()
        for start in range(0, len(order), batch_size or len(order)):
            rows = order[start : start + (batch_size or len(order))]
            yield RolloutBufferSamples(*(torch.from_numpy(c[rows]).to(self._device) for c in columns))

    def shuffled(self) -> NDArray[np.int64]:
        """Draws the order (n,) in which one epoch passes over the steps."""
        return self._generator.permutation(len(self.rewards))

    def columns(self) -> tuple[NDArray[np.float32], ...]:
        """Returns all that a mini-batch holds of the n steps, in the order of `ppo.losses.Steps`."""
        return (
            *(self.observations, self.actions, self.values),
            *(self.log_probabilities, self.advantages, self.returns),
        )

    def state(self) -> dict[str, Any]:
        """Returns the steps so far, by name of the column."""
        return {name: getattr(self, name)[: self._size] for name in _STORED}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Takes over the steps of another rollout's `state`."""
        self._size = len(state["rewards"])
        for name in _STORED:
            getattr(self, name)[: self._size] = state[name]


@kernel
def _discounted_sums(
    errors: NDArray[np.float32], decays: NDArray[np.float32], sums: NDArray[np.float32]
) -> None:
    total = np.float32(0)
    for index in range(len(errors) - 1, -1, -1):
        total = errors[index] + decays[index] * total
        sums[index] = total


_STORED = ("observations", "actions", "rewards", "ended", "values", "log_probabilities")

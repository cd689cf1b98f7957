"""SAC's update of k runs at once: plain batched torch, which autograd differentiates."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import torch

from tma_ray.students.cohort.adam import StackedAdam, keep
from tma_ray.students.cohort.execution import compile_if, hidden_type
from tma_ray.students.cohort.networks import stacked_pass, twin_pass
from tma_ray.students.cohort.padding import PaddedLayout
from tma_ray.students.cohort.rows import leaf, narrowed
from tma_ray.students.hyperparameters import SACHyperparameters
from tma_ray.students.mlp.layout import Layout
from tma_ray.students.sac.losses import (
    Pass,
    Transitions,
    actor_loss,
    critic_loss,
    soft_values,
    squashed_draw,
)


class SACLayouts(NamedTuple):
    """Layouts of the networks of one run.

    Attributes:
        actor: observations to means and log deviations.
        critic: observations and actions to a value.
    """

    actor: PaddedLayout
    critic: PaddedLayout

    @classmethod
    def of(cls, sizes: tuple[int, int], hidden_units: tuple[int, ...]) -> SACLayouts:
        """Returns the layouts for `sizes` of observations and actions."""
        observation, action = sizes
        actor = Layout((observation, *hidden_units, 2 * action))
        critic = Layout((observation + action, *hidden_units, 1))
        return cls(PaddedLayout.of(actor), PaddedLayout.of(critic))


class StackedSACUpdate:
    """Networks and optimisers of k runs, in padded layouts, and the update that trains them.

    Args:
        layouts: of the networks.
        hyper: hyper-parameters of the student.
        width: number of runs k.
        like: an empty tensor with the device and the type of the parameters.
        compiled: see `compile_if`.

    Attributes:
        actor: parameters (k, p), a leaf of autograd.
        critics: parameters of both critics (k, 2, q), likewise.
        targets: parameters of both target critics (k, 2, q).
        actor_adam: the actor's optimiser.
        critic_adam: the critics' optimiser.
        steps: of the optimisers (k,).
        losses: of critics and actor at the last update (k, 2).
    """

    def __init__(
        self,
        layouts: SACLayouts,
        hyper: SACHyperparameters,
        width: int,
        like: torch.Tensor,
        compiled: bool | str = False,
    ) -> None:
        self.layouts, self._hyper = layouts, hyper
        self._hidden = hidden_type(hyper.matmul_precision, like.dtype)
        self.actor = like.new_zeros(width, layouts.actor.length).requires_grad_()
        self.critics = like.new_zeros(width, 2, layouts.critic.length).requires_grad_()
        self.targets = like.new_zeros(width, 2, layouts.critic.length)
        self.actor_adam = StackedAdam(self.actor, hyper.learning_rate)
        self.critic_adam = StackedAdam(self.critics, hyper.learning_rate)
        self.steps = torch.zeros(width, dtype=torch.int64, device=like.device)
        self.losses = like.new_zeros(width, 2)
        # compiled part by part: autograd runs between them, through what the compiler derived
        self._parts = [compile_if(compiled, part) for part in self._eager()]

    def _eager(self) -> list[Callable[..., Any]]:
        return [self._critic_losses, self._actor_losses, self._step_critics, self._step_actor]

    def row(self, slot: int) -> StackedSACUpdate:
        """Returns the update of the run in `slot` alone, over the same memory."""
        own = narrowed(self, slot, "targets", "steps", "losses")
        own.actor, own.critics = leaf(self.actor, slot), leaf(self.critics, slot)
        own.actor_adam = self.actor_adam.row(slot, own.actor)
        own.critic_adam = self.critic_adam.row(slot, own.critics)
        own._parts = own._eager()
        return own

    def __call__(
        self, batch: Transitions, noise: torch.Tensor, next_noise: torch.Tensor, active: torch.Tensor
    ) -> None:
        """Takes one step of critics, actor and targets of the `active` runs (k,).

        Args:
            batch: of each run (k, n, ...).
            noise: of the actions that the actor is judged by (k, n, a).
            next_noise: of the next observations' actions (k, n, a).
            active: True for runs that take part; nothing of the others changes by a bit.
        """
        critic_losses, actor_losses, step_critics, step_actor = self._parts
        losses = critic_losses(batch, next_noise)
        (gradient,) = torch.autograd.grad(losses.sum(), self.critics)
        step_critics(gradient, losses.detach(), active)
        losses = actor_losses(batch.observations, noise)
        (gradient,) = torch.autograd.grad(losses.sum(), self.actor)
        step_actor(gradient, losses.detach(), active)

    def _critic_losses(self, batch: Transitions, noise: torch.Tensor) -> torch.Tensor:
        hyper = self._hyper
        with torch.no_grad():
            draw = squashed_draw(self._outputs(batch.next_observations), noise, hyper.log_std)
            targets = self._pair(self.targets)
            values = soft_values(targets, batch.next_observations, draw, hyper.entropy_coefficient)
            goals = batch.rewards + (1 - batch.dones) * hyper.gamma * values
        return critic_loss(self._pair(self.critics), batch, goals)

    def _actor_losses(self, observations: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        hyper, critics = self._hyper, self._pair(self.critics.detach())
        draw = squashed_draw(self._outputs(observations), noise, hyper.log_std)
        return actor_loss(critics, observations, draw, hyper.entropy_coefficient)

    def _step_critics(self, gradient: torch.Tensor, losses: torch.Tensor, active: torch.Tensor) -> None:
        with torch.no_grad():
            self.critic_adam.step(gradient, self.steps, active)
            keep(self.losses[:, 0], losses, active)

    def _step_actor(self, gradient: torch.Tensor, losses: torch.Tensor, active: torch.Tensor) -> None:
        """Steps the actor, and what follows the steps: targets and counts."""
        with torch.no_grad():
            self.actor_adam.step(gradient, self.steps, active)
            keep(self.losses[:, 1], losses, active)
            moved = torch.lerp(self.targets, self.critics, self._hyper.target_rate)
            keep(self.targets, moved, active[:, None, None])
            self.steps.add_(active.long())

    def _pair(self, parameters: torch.Tensor) -> Pass:
        """Returns the function that gives both critics' values (k, n, 2) by `parameters` (k, 2, q)."""
        return partial(twin_pass, parameters, self.layouts.critic, hidden=self._hidden)

    def _outputs(self, observations: torch.Tensor) -> torch.Tensor:
        return stacked_pass(self.actor, self.layouts.actor, observations, self._hidden)

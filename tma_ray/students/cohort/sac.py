"""Stacked SAC that updates many runs at once."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.cohort.device import (
    Purpose,
    compile_if,
    hidden_type,
    integers_below,
    precision,
    standard_normals,
    words,
    words_of,
)
from tma_ray.students.cohort.learner import StackedLearner, leaf, narrowed
from tma_ray.students.cohort.networks import PaddedLayout, StackedAdam, stacked_pass, twin_pass, write_masked
from tma_ray.students.cohort.replay import StackedReplay
from tma_ray.students.hyperparameters import MatmulPrecision, SACHyperparameters
from tma_ray.students.mlp.layout import Layout
from tma_ray.students.sac import Pass, Transitions, actor_loss, critic_loss, soft_values, squashed_draw


class SACNetworks(NamedTuple):
    """Learned state of a run in host memory, without padding.

    Attributes:
        actor: parameters of the actor (p,), with Adam's moments `actor_mean` and `actor_square`.
        critics: parameters of both critics (2, q), with `critics_mean` and `critics_square`.
        targets: parameters of both target critics (2, q).
        step: number of steps of both optimisers.
        number: number of the run's updates so far, part of the key of its random numbers.
    """

    actor: NDArray[np.floating]
    critics: NDArray[np.floating]
    targets: NDArray[np.floating]
    actor_mean: NDArray[np.floating]
    actor_square: NDArray[np.floating]
    critics_mean: NDArray[np.floating]
    critics_square: NDArray[np.floating]
    step: int
    number: int


class StackedSAC(StackedLearner):
    """SAC of many runs, with random draws from a Philox generator keyed by run and update.

    Compiling takes minutes once. `sizes` are the lengths of an observation and an action.
    """

    def __init__(
        self,
        sizes: tuple[int, int],
        hyper: SACHyperparameters,
        width: int,
        capacity: int,
        device: torch.device,
        dtype: torch.dtype = torch.float32,
        compiled: bool | str = False,
    ) -> None:
        super().__init__(width, device, dtype, hyper.matmul_precision, compiled)
        (observation, self._action_size), self._hyper = sizes, hyper
        self._hidden = hidden_type(hyper.matmul_precision, dtype)
        critic = Layout((observation + self._action_size, *hyper.hidden_units, 1))
        self._actor_layout = PaddedLayout.of(hyper.layout(*sizes))
        self._critic_layout = PaddedLayout.of(critic)
        like = torch.empty(0, dtype=dtype, device=device)
        self._actor = like.new_zeros(width, self._actor_layout.length).requires_grad_()
        self._critics = like.new_zeros(width, 2, self._critic_layout.length).requires_grad_()
        self._targets = like.new_zeros(width, 2, self._critic_layout.length)
        self._actor_adam = StackedAdam(self._actor, hyper.learning_rate)
        self._critic_adam = StackedAdam(self._critics, hyper.learning_rate)
        self._steps = torch.zeros(width, dtype=torch.int64, device=device)
        self._losses = like.new_zeros(width, 2)
        self._replay = StackedReplay(width, capacity, sizes, device)
        self._numbers = torch.zeros(width, dtype=torch.int64, device=device)
        self._keys = torch.zeros(width, 2, dtype=torch.int64, device=device)
        layouts = self._actor_layout, self._critic_layout
        self._columns = [torch.from_numpy(layout.columns()).to(device) for layout in layouts]
        # compiled separately, because autograd runs in between
        self._parts = [compile_if(compiled, part) for part in self._eager()]

    def _eager(self) -> list[Callable[..., Any]]:
        return [self._draw, self._critic_losses, self._actor_losses, self._step_critics, self._step_actor]

    def join(self, slot: int, networks: SACNetworks, key: int) -> None:
        """Assign the free `slot` to a new run that starts from `networks` and an empty replay buffer.

        The 64-bit `key` identifies the run's random draws.
        """
        self.leave(slot)
        self._write(slot, networks)
        for word, half in enumerate(words_of(key)):
            self._keys[slot, word].fill_(half)

    def leave(self, slot: int) -> None:  # noqa: D102
        super().leave(slot)
        self._replay.clear(slot)
        self._losses[slot].zero_()

    def store(
        self,
        slot: int,
        observations: NDArray[np.float32],
        actions: NDArray[np.float32],
        rewards: NDArray[np.float32],
        terminated: bool,
    ) -> None:
        """Append consecutive transitions to the replay buffer of the run in `slot`."""
        moves = self._replay.moves
        self._replay.store(slot, observations, actions, rewards, terminated)
        if self._replay.moves != moves:  # captured graphs would refer to freed memory
            self._repeated.forget()
            self._rows.clear()

    def networks(self, slot: int) -> SACNetworks:
        """Return the learned state of the run in `slot`."""
        return SACNetworks._make(self._read(slot))

    def values(
        self, slot: int, observations: NDArray[np.float32], noise: NDArray[np.floating]
    ) -> NDArray[np.float64]:
        """Return V(s) (n,) of the run in `slot`, entropy bonus included, averaged over m sampled actions.

        Args:
            slot: slot of the run.
            observations: observations (n, o).
            noise: standard normal noise of the actions (m, n, a).
        """
        hyper, one = self._hyper, slice(slot, slot + 1)
        inputs = self._on_device(observations)[None]
        total = torch.zeros(len(observations), dtype=torch.float64, device=self._device)
        with torch.no_grad(), precision(MatmulPrecision.HIGHEST):
            outputs = stacked_pass(self._actor[one], self._actor_layout, inputs, self._dtype)
            critics = partial(twin_pass, self._critics[one], self._critic_layout, hidden=self._dtype)
            for sample in self._on_device(noise):
                draw = squashed_draw(outputs, sample[None], hyper.log_std)
                total += soft_values(critics, inputs, draw, hyper.entropy_coefficient)[0, :, 0]
        values: NDArray[np.float64] = (total / len(noise)).cpu().numpy()
        return values

    def metrics(self, slot: int) -> dict[str, float]:
        """Return the losses at the last update of the run in `slot`."""
        critics, actor = self._losses[slot].tolist()
        return {"critic_loss": critics, "actor_loss": actor}

    def _parameter_groups(self) -> list[tuple[torch.Tensor, torch.Tensor]]:
        actors, critics = (self._actor,), (self._critics, self._targets)
        moments = [(adam.mean, adam.square) for adam in (self._actor_adam, self._critic_adam)]
        kinds = zip((actors, critics, *moments), (*self._columns, *self._columns), strict=True)
        return [(memory, columns) for memories, columns in kinds for memory in memories]

    def _counters(self) -> list[torch.Tensor]:
        return [self._steps, self._numbers]

    def _row(self, slot: int) -> "StackedSAC":
        row = narrowed(self, slot, "_owed", "_numbers", "_keys", "_targets", "_steps", "_losses")
        row._actor, row._critics = leaf(self._actor, slot), leaf(self._critics, slot)
        row._actor_adam = self._actor_adam.row(slot, row._actor)
        row._critic_adam = self._critic_adam.row(slot, row._critics)
        row._replay, row._parts = self._replay.row(slot), row._eager()
        return row

    def _advance_once(self) -> None:
        ring, noise, next_noise, active = self._parts[0]()
        self._learn(self._replay.gather(ring, self._dtype), noise, next_noise, active)
        self._numbers.add_(active.long())
        self._owed.sub_(active.long())

    def _draw(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return ring indices (k, n), noise and next noise (k, n, a), and a mask of active runs (k,)."""
        batch, action = self._hyper.batch_size, self._action_size
        drawn = words(self._keys, self._numbers, Purpose.BATCH, batch)
        ring = self._replay.newest(integers_below(self._replay.kept, drawn))
        drawn = words(self._keys, self._numbers, Purpose.NOISE, 2 * batch * action)
        noise = standard_normals(drawn, self._dtype).view(len(drawn), 2, batch, action)
        return ring, noise[:, 0], noise[:, 1], self._owed > 0

    def _learn(
        self, batch: Transitions, noise: torch.Tensor, next_noise: torch.Tensor, active: torch.Tensor
    ) -> None:
        """Update critics, actor and targets of the `active` runs (k,) once, leaving all others unchanged.

        `noise` and `next_noise` (k, n, a) are those of actions at the observations and the next observations.
        """
        _, critic_losses, actor_losses, step_critics, step_actor = self._parts
        losses = critic_losses(batch, next_noise)
        (gradient,) = torch.autograd.grad(losses.sum(), self._critics)
        step_critics(gradient, losses.detach(), active)
        losses = actor_losses(batch.observations, noise)
        (gradient,) = torch.autograd.grad(losses.sum(), self._actor)
        step_actor(gradient, losses.detach(), active)

    def _critic_losses(self, batch: Transitions, noise: torch.Tensor) -> torch.Tensor:
        hyper = self._hyper
        with torch.no_grad():
            draw = squashed_draw(self._outputs(batch.next_observations), noise, hyper.log_std)
            targets = self._pair(self._targets)
            values = soft_values(targets, batch.next_observations, draw, hyper.entropy_coefficient)
            goals = batch.rewards + (1 - batch.dones) * hyper.gamma * values
        return critic_loss(self._pair(self._critics), batch, goals)

    def _actor_losses(self, observations: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        hyper, critics = self._hyper, self._pair(self._critics.detach())
        draw = squashed_draw(self._outputs(observations), noise, hyper.log_std)
        return actor_loss(critics, observations, draw, hyper.entropy_coefficient)

    def _step_critics(self, gradient: torch.Tensor, losses: torch.Tensor, active: torch.Tensor) -> None:
        with torch.no_grad():
            self._critic_adam.step(gradient, self._steps, active)
            write_masked(self._losses[:, 0], losses, active)

    def _step_actor(self, gradient: torch.Tensor, losses: torch.Tensor, active: torch.Tensor) -> None:
        """Step the actor, then update the targets and step counts."""
        with torch.no_grad():
            self._actor_adam.step(gradient, self._steps, active)
            write_masked(self._losses[:, 1], losses, active)
            moved = torch.lerp(self._targets, self._critics, self._hyper.target_rate)
            write_masked(self._targets, moved, active[:, None, None])
            self._steps.add_(active.long())

    def _pair(self, parameters: torch.Tensor) -> Pass:
        """Return the forward pass of both critics, with outputs (k, n, 2), for `parameters` (k, 2, q)."""
        return partial(twin_pass, parameters, self._critic_layout, hidden=self._hidden)

    def _outputs(self, observations: torch.Tensor) -> torch.Tensor:
        return stacked_pass(self._actor, self._actor_layout, observations, self._hidden)

"""Soft actor-critic of many runs at once: networks, optimisers and replay are rows of the same tensors."""

from __future__ import annotations

import math
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
from tma_ray.students.cohort.learner import Device, Stack, StackedLearner, leaf, narrowed
from tma_ray.students.cohort.networks import PaddedLayout, StackedAdam, keep, stacked_pass, twin_pass
from tma_ray.students.cohort.replay import ReplayContents, StackedReplay
from tma_ray.students.hyperparameters import MatmulPrecision, SACHyperparameters
from tma_ray.students.mlp.layout import Layout
from tma_ray.students.sac import (
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
        """Return the layouts for `sizes` of observations and actions."""
        observation, action = sizes
        actor = Layout((observation, *hidden_units, 2 * action))
        critic = Layout((observation + action, *hidden_units, 1))
        return cls(PaddedLayout.of(actor), PaddedLayout.of(critic))


class StackedSACUpdate:
    """Networks and optimisers of k runs, in padded layouts, and the update that trains them.

    Args:
        layouts: layouts of the networks.
        hyper: hyper-parameters of the student.
        width: number of runs k.
        like: an empty tensor with the device and the type of the parameters.
        compiled: see `compile_if`.

    Attributes:
        actor: parameters (k, p), a leaf of autograd.
        critics: parameters of both critics (k, 2, q), a leaf of autograd too.
        targets: parameters of both target critics (k, 2, q).
        actor_adam: the actor's optimiser.
        critic_adam: the critics' optimiser.
        steps: steps of the optimisers (k,).
        losses: losses of critics and actor at the last update (k, 2).
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
        """Return the update of the run in `slot` alone, over the same memory."""
        own = narrowed(self, slot, "targets", "steps", "losses")
        own.actor, own.critics = leaf(self.actor, slot), leaf(self.critics, slot)
        own.actor_adam = self.actor_adam.row(slot, own.actor)
        own.critic_adam = self.critic_adam.row(slot, own.critics)
        own._parts = own._eager()
        return own

    def __call__(
        self, batch: Transitions, noise: torch.Tensor, next_noise: torch.Tensor, active: torch.Tensor
    ) -> None:
        """Take one step of critics, actor and targets of the `active` runs (k,).

        Args:
            batch: batch of each run (k, n, ...).
            noise: noise of the actions that the actor's loss is computed of (k, n, a).
            next_noise: noise of the next observations' actions (k, n, a).
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
        """Step the actor, then update targets and counts."""
        with torch.no_grad():
            self.actor_adam.step(gradient, self.steps, active)
            keep(self.losses[:, 1], losses, active)
            moved = torch.lerp(self.targets, self.critics, self._hyper.target_rate)
            keep(self.targets, moved, active[:, None, None])
            self.steps.add_(active.long())

    def _pair(self, parameters: torch.Tensor) -> Pass:
        """Return the function that gives both critics' values (k, n, 2) by `parameters` (k, 2, q)."""
        return partial(twin_pass, parameters, self.layouts.critic, hidden=self._hidden)

    def _outputs(self, observations: torch.Tensor) -> torch.Tensor:
        return stacked_pass(self.actor, self.layouts.actor, observations, self._hidden)


class SACNetworks(NamedTuple):
    """What a run has learned, on the host: flat parameters without padding, as a run alone has them.

    Attributes:
        actor: parameters (p,).
        critics: parameters of both critics (2, q).
        targets: parameters of both target critics (2, q).
        actor_mean: Adam's running mean of the actor's gradient (p,).
        actor_square: Adam's running mean of the actor's squared gradient (p,).
        critics_mean: Adam's running mean of the critics' gradient (2, q).
        critics_square: Adam's running mean of the critics' squared gradient (2, q).
        step: number of steps of both optimisers since the networks are new.
        number: updates of the run so far, which random draws are keyed by.
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
    """SAC of many runs; random draws come from Philox, keyed by run and by the number of its update.

    Args:
        sizes: lengths o of an observation and a of an action.
        hyper: hyper-parameters of the student.
        width: number of slots k.
        capacity: transitions kept per run.
        device: device of the learner.
        dtype: data type of parameters, losses and optimisers.
        compiled: the update is compiled by torch, which takes minutes once; a string is the compiler's mode.

    Attributes:
        owed: number of updates that are due, by slot (k,).
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
        super().__init__(width, Device(device, dtype, hyper.matmul_precision, compiled))
        self._action_size, self._hyper = sizes[1], hyper
        self._layouts = SACLayouts.of(sizes, hyper.hidden_units)
        like = torch.empty(0, dtype=dtype, device=device)
        self._update = StackedSACUpdate(self._layouts, hyper, width, like, compiled)
        self._replay = StackedReplay(width, capacity, sizes, device)
        self._numbers = torch.zeros(width, dtype=torch.int64, device=device)
        self._keys = torch.zeros(width, 2, dtype=torch.int64, device=device)
        self._places = [torch.from_numpy(layout.places()).to(device) for layout in self._layouts]
        self._draw_once = compile_if(compiled, self._draw)
        self._moves = 0

    def join(self, slot: int, networks: SACNetworks, key: int) -> None:
        """Give the idle `slot` to a run, which has no replay yet.

        Args:
            slot: slot of the run.
            networks: networks of the run.
            key: key of the run's random draws, 64 bits.
        """
        self.leave(slot)
        self._write(slot, networks)
        for word, half in enumerate(words_of(key)):
            self._keys[slot, word].fill_(half)

    def leave(self, slot: int) -> None:  # noqa: D102
        super().leave(slot)
        self._replay.clear(slot)
        self._update.losses[slot].zero_()

    def store(
        self,
        slot: int,
        observations: NDArray[np.float32],
        actions: NDArray[np.float32],
        rewards: NDArray[np.float32],
        terminated: bool,
    ) -> None:
        """Add an episode's transitions to the replay of `slot`, or a part's; see `StackedReplay.store`.

        `terminated` is False of an episode that is cut or goes on.
        """
        self._replay.store(slot, observations, actions, rewards, terminated)
        self._follow_memory()

    def networks(self, slot: int) -> SACNetworks:
        """Return the networks of the run in `slot`."""
        return SACNetworks._make(self._read(slot))

    def replay(self, slot: int) -> ReplayContents:
        """Return the transitions that the run in `slot` keeps."""
        return self._replay.contents(slot)

    def fill(self, slot: int, contents: ReplayContents) -> None:
        """Give the run in `slot` the transitions that `replay` returned, and no others."""
        self._replay.fill(slot, contents)
        self._follow_memory()

    def values(
        self, slot: int, observations: NDArray[np.float32], noise: NDArray[np.floating] | None = None
    ) -> NDArray[np.float64]:
        """Return V(s) (n,) of the run in `slot`, entropy bonus included.

        Args:
            slot: slot of the run.
            observations: values (n, o).
            noise: standard normal, of the actions that V averages over (m, n, a); by default that of the
                run's key and its number of updates, `value_samples` actions a state.
        """
        hyper, one = self._hyper, slice(slot, slot + 1)
        inputs = self._on_device(observations)[None]
        drawn = self._value_noise(one, len(observations)) if noise is None else self._on_device(noise)
        total = torch.zeros(len(observations), dtype=torch.float64, device=self._device)
        with torch.no_grad(), precision(MatmulPrecision.HIGHEST):
            actor, critic = self._layouts
            outputs = stacked_pass(self._update.actor[one], actor, inputs, self._dtype)
            targets = partial(twin_pass, self._update.critics[one], critic, hidden=self._dtype)
            for sample in drawn:
                draw = squashed_draw(outputs, sample[None], hyper.log_std)
                total += soft_values(targets, inputs, draw, hyper.entropy_coefficient)[0, :, 0]
        values: NDArray[np.float64] = (total / len(drawn)).cpu().numpy()
        return values

    def figures(self, slot: int) -> dict[str, float]:
        """Return the losses of critics and actor at the last update of the run in `slot`."""
        critics, actor = self._update.losses[slot].tolist()
        return {"critic_loss": critics, "actor_loss": actor}

    def _stacks(self) -> list[Stack]:
        update, (actor, critic) = self._update, self._places
        networks = Stack(update.actor, actor), Stack(update.critics, critic), Stack(update.targets, critic)
        actors, critics = update.actor_adam, update.critic_adam
        moments = [Stack(moment, actor) for moment in (actors.mean, actors.square)]
        return [*networks, *moments, *(Stack(moment, critic) for moment in (critics.mean, critics.square))]

    def _counters(self) -> list[torch.Tensor]:
        return [self._update.steps, self._numbers]

    def _follow_memory(self) -> None:
        """Drop the captured graph if the replay, which it reads, has moved."""
        if self._replay.moves != self._moves:
            self._repeated.forget()
            self._rows.clear()
            self._moves = self._replay.moves

    def _row(self, slot: int) -> StackedSAC:
        own = narrowed(self, slot, "_owed", "_numbers", "_keys")
        own._update, own._replay = self._update.row(slot), self._replay.row(slot)
        own._draw_once = own._draw
        return own

    def _advance_once(self) -> None:
        ring, noise, next_noise, active = self._draw_once()
        batch = self._replay.gather(ring, self._dtype)
        self._update(batch, noise, next_noise, active)
        self._numbers.add_(active.long())
        self._owed.sub_(active.long())

    def _draw(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return places in the replay (k, n), noise and next noise (k, n, a), and who takes part (k,)."""
        batch, action = self._hyper.batch_size, self._action_size
        drawn = words(self._keys, self._numbers, Purpose.BATCH, batch)
        ring = self._replay.newest(integers_below(self._replay.kept, drawn))
        drawn = words(self._keys, self._numbers, Purpose.NOISE, 2 * batch * action)
        noise = standard_normals(drawn, self._dtype).view(len(drawn), 2, batch, action)
        return ring, noise[:, 0], noise[:, 1], self._owed > 0

    def _value_noise(self, one: slice, states: int) -> torch.Tensor:
        """Return noise (m, n, a) for the values of n `states`, the same until the next update."""
        shape = self._hyper.value_samples, states, self._action_size
        count = math.prod(shape)
        drawn = words(self._keys[one], self._numbers[one], Purpose.VALUES, count + count % 2)
        return standard_normals(drawn, self._dtype)[0, :count].view(shape)

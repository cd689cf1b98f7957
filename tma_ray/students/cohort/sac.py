"""Soft actor-critic of many runs at once: networks, optimisers and replay are rows of the same tensors."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.cohort.execution import compile_if, precision
from tma_ray.students.cohort.learner import Device, Stack, StackedLearner
from tma_ray.students.cohort.networks import stacked_pass, twin_pass
from tma_ray.students.cohort.philox import Purpose, integers_below, standard_normals, words, words_of
from tma_ray.students.cohort.replay import ReplayContents, StackedReplay
from tma_ray.students.cohort.rows import narrowed
from tma_ray.students.cohort.sac_update import SACLayouts, StackedSACUpdate
from tma_ray.students.hyperparameters import MatmulPrecision, SACHyperparameters
from tma_ray.students.sac.losses import soft_values, squashed_draw


class SACNetworks(NamedTuple):
    """What a run has learned, on the host: flat parameters without padding, as a run alone has them.

    Attributes:
        actor: parameters (p,).
        critics: parameters of both critics (2, q).
        targets: parameters of both target critics (2, q).
        actor_mean: of Adam (p,).
        actor_square: of Adam (p,).
        critics_mean: of Adam (2, q).
        critics_square: of Adam (2, q).
        step: of both optimisers, since the networks are new.
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
        device: where to learn.
        dtype: of parameters, losses and optimisers.
        compiled: the update is compiled by torch, which takes minutes once; a string is the compiler's mode.

    Attributes:
        owed: updates that are due, by slot (k,).
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
        """Gives the idle `slot` to a run, which has no replay yet.

        Args:
            slot: which one.
            networks: of the run.
            key: of the run's random draws, 64 bits.
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
        """Adds an episode's transitions to the replay of `slot`, or a part's; see `StackedReplay.store`.

        `terminated` is False of an episode that is cut or goes on.
        """
        self._replay.store(slot, observations, actions, rewards, terminated)
        self._follow_memory()

    def networks(self, slot: int) -> SACNetworks:
        """Returns what the run in `slot` has learned."""
        return SACNetworks._make(self._read(slot))

    def replay(self, slot: int) -> ReplayContents:
        """Returns the transitions that the run in `slot` keeps."""
        return self._replay.contents(slot)

    def fill(self, slot: int, contents: ReplayContents) -> None:
        """Gives the run in `slot` the transitions that `replay` returned, and no others."""
        self._replay.fill(slot, contents)
        self._follow_memory()

    def values(
        self, slot: int, observations: NDArray[np.float32], noise: NDArray[np.floating] | None = None
    ) -> NDArray[np.float64]:
        """Returns V(s) (n,) of the run in `slot`, entropy bonus included.

        Args:
            slot: of the run.
            observations: (n, o).
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
        """Returns the losses of critics and actor at the last update of the run in `slot`."""
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
        """Drops the captured graph if the replay, which it reads, has moved."""
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
        """Returns places in the replay (k, n), noise and next noise (k, n, a), and who takes part (k,)."""
        batch, action = self._hyper.batch_size, self._action_size
        drawn = words(self._keys, self._numbers, Purpose.BATCH, batch)
        ring = self._replay.newest(integers_below(self._replay.kept, drawn))
        drawn = words(self._keys, self._numbers, Purpose.NOISE, 2 * batch * action)
        noise = standard_normals(drawn, self._dtype).view(len(drawn), 2, batch, action)
        return ring, noise[:, 0], noise[:, 1], self._owed > 0

    def _value_noise(self, one: slice, states: int) -> torch.Tensor:
        """Returns noise (m, n, a) for the values of n `states`, the same until the next update."""
        shape = self._hyper.value_samples, states, self._action_size
        count = math.prod(shape)
        drawn = words(self._keys[one], self._numbers[one], Purpose.VALUES, count + count % 2)
        return standard_normals(drawn, self._dtype)[0, :count].view(shape)

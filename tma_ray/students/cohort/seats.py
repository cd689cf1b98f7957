"""The places of runs in a stacked learner: conversion from and to students that learn alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.base import update_key
from tma_ray.students.cohort.learner import StackedLearner
from tma_ray.students.cohort.ppo import PPONetworks, RolloutColumns, StackedPPO
from tma_ray.students.cohort.sac import SACNetworks, StackedSAC
from tma_ray.students.players import CohortFullError, Membership, PlayerState
from tma_ray.students.players.link import CohortSettings
from tma_ray.students.ppo import PPO
from tma_ray.students.sac import SAC
from tma_ray.students.sb3.base import StableBaselinesStudent

S = TypeVar("S", bound=StackedLearner)
H = TypeVar("H", bound=StableBaselinesStudent[Any, Any])


class Seat(ABC, Generic[S, H]):
    """A slot of a stack, with the student that owns the run's networks whenever they are not in the stack.

    That student makes the initial weights, writes and reads the files: a run may move out of a cohort and
    into one.
    """

    student_type: type[H]

    def __init__(self, membership: Membership, stack: S, slot: int) -> None:
        self.stack, self.slot = stack, slot
        self._key = update_key(membership.seed)
        self.student = self.student_type(
            membership.observation_space, membership.action_space, membership.hyperparameters, membership.seed
        )
        self._enter()

    @abstractmethod
    def learn(self, experience: tuple[Any, ...], updates: int) -> None:
        """Store what a player hands over; `updates` are due from now on."""

    @abstractmethod
    def _enter(self) -> None:
        """Copy the student's networks and experience into the stack."""

    @abstractmethod
    def _copy_back(self) -> None:
        """Copy the networks of the stack into the student."""

    @abstractmethod
    def _put(self, state: PlayerState) -> None:
        """Give the player's half of the state to the student."""

    @abstractmethod
    def _player_state(self) -> dict[str, Any]:
        """Return the player's half of the student's experience."""

    def leave(self) -> None:
        """Free the slot."""
        self.stack.leave(self.slot)

    def weights(self) -> NDArray[np.float32]:
        """Return the parameters that the player acts with."""
        return _array(self.stack.actors([self.slot])[0])

    def values(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the state values (n,) of `observations` (n, o)."""
        self._copy_back()
        return self.student.state_values(observations)

    def reset(self) -> None:
        """Replace networks, optimisers and stored experience by new ones."""
        self.student.reset()
        self._enter()

    def save(self, folder: Path, state: PlayerState, incremental: bool) -> Callable[[], tuple[str, ...]]:
        """Return a function that writes the student's complete state, in any thread while the run waits."""
        self._copy_back()
        self._put(state)
        for generator, saved in zip(self.student._generators[:2], state.generators[:2], strict=True):
            generator.bit_generator.state = saved
        return lambda: self.student.save(folder, incremental)

    def read(self, folder: Path) -> None:
        """Read the state in `folder`, in any thread; `take_over` follows."""
        self.student.load(folder)

    def take_over(self) -> PlayerState:
        """Load the state that was read; return the player's half."""
        self._enter()
        generators = [dict(each.bit_generator.state) for each in self.student._generators]
        return PlayerState(generators, self._player_state())

    def save_policy(self, folder: Path, state: PlayerState) -> None:
        """Write the greedy policy."""
        self._copy_back()
        self._put(state)
        self.student.save_policy(folder)


class SACSeat(Seat[StackedSAC, SAC]):
    """A run of SAC in a stack. The student keeps a copy of the replay, for checkpoints."""

    student_type = SAC

    def learn(self, experience: tuple[Any, ...], updates: int) -> None:  # noqa: D102
        self.student.replay.extend(*experience)
        self.stack.store(self.slot, *experience)
        self.stack.owe(self.slot, updates)

    def _enter(self) -> None:
        update = self.student.update
        actor, critics = update.actor_adam.moments, update.critic_adam.moments
        networks = SACNetworks(
            actor=_array(update.actor.values),
            critics=_pair(update.critics.values),
            targets=_pair(update.targets.values),
            actor_mean=_array(actor[0]),
            actor_square=_array(actor[1]),
            critics_mean=_pair(critics[0]),
            critics_square=_pair(critics[1]),
            step=update.actor_adam.steps,
            number=self.student.model._n_updates,
        )
        self.stack.join(self.slot, networks, self._key)
        for piece in self.student.replay.pieces():
            self.stack.store(self.slot, *piece)

    def values(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the state values (n,) of `observations` (n, o), on the stack's device.

        Their noise is the student's, so that a run that learns alone has the same, up to rounding.
        """
        return self.stack.values(self.slot, observations, self.student.value_noise(len(observations)))

    def _copy_back(self) -> None:
        update, networks = self.student.update, self.stack.networks(self.slot)
        own = update.actor, update.critics, update.targets
        for flat, values in zip(own, networks[:3], strict=True):
            flat.values.copy_(_flat(values))
        update.actor_adam.put(_flat(networks.actor_mean), _flat(networks.actor_square), networks.step)
        update.critic_adam.put(_flat(networks.critics_mean), _flat(networks.critics_square), networks.step)
        self.student.changed(networks.number)

    def _put(self, state: PlayerState) -> None:
        self.student.steps = state.experience["steps"]

    def _player_state(self) -> dict[str, Any]:
        return {"steps": self.student.steps}


class PPOSeat(Seat[StackedPPO, PPO]):
    """A run of PPO in a stack. Statistics and the rollout are the player's."""

    student_type = PPO

    def learn(self, experience: tuple[Any, ...], updates: int) -> None:  # noqa: D102
        *columns, orders = experience
        self.stack.store(self.slot, RolloutColumns(*columns), orders)
        assert self.stack.owed[self.slot] == updates, "players and learners count the same updates"

    def _enter(self) -> None:
        update = self.student.update
        mean, square = map(_array, update.adam.moments)
        networks = PPONetworks(_array(update.flat.values), mean, square, update.adam.steps)
        self.stack.join(self.slot, networks)

    def _copy_back(self) -> None:
        update, networks = self.student.update, self.stack.networks(self.slot)
        hyper = self.student.hyperparameters
        update.flat.values.copy_(_flat(networks.parameters))
        update.adam.put(_flat(networks.mean), _flat(networks.square), networks.step)
        self.student.changed(networks.step * hyper.batch_size // hyper.steps_per_update)

    def _put(self, state: PlayerState) -> None:
        self.student.normaliser = state.experience["normaliser"]
        self.student.rollout.restore(state.experience["rollout"])
        if state.experience["average"] is not None:
            self.student.put_average(state.experience["average"])

    def _player_state(self) -> dict[str, Any]:
        state = {"normaliser": self.student.normaliser, "rollout": self.student.rollout.state()}
        return state | {"average": self.student.average}


def _array(values: torch.Tensor) -> NDArray[np.float32]:
    return values.detach().numpy(force=True)


def _pair(values: torch.Tensor) -> NDArray[np.float32]:
    """Return the parameters (2q,) of two networks in a row each (2, q)."""
    return _array(values).reshape(2, -1)


def _flat(values: NDArray[np.floating]) -> torch.Tensor:
    return torch.from_numpy(values).reshape(-1)


KINDS: dict[str, tuple[type[Any], type[Seat[Any, Any]]]] = {
    "ppo": (StackedPPO, PPOSeat),
    "sac": (StackedSAC, SACSeat),
}
"""Stacked learner, and the seats in it, by the student's name."""


class Stacks:
    """The stacks of a learner. Runs share one if student, sizes and hyper-parameters are equal.

    Attributes:
        settings: settings of the cohort.
        stacks: stacks in the order in which they were made.
    """

    def __init__(self, settings: CohortSettings) -> None:
        self.settings = settings
        self.stacks: list[Any] = []
        self._by_kind: dict[Any, Any] = {}
        self._free: dict[int, list[int]] = {}

    def seat(self, membership: Membership) -> Seat[Any, Any]:
        """Return a seat for a new player.

        Raises:
            CohortFullError: all slots of its stack are taken.
        """
        stack_type, seat_type = KINDS[membership.student]
        sizes = membership.observation_space.shape[0], membership.action_space.shape[0]
        kind = membership.student, sizes, membership.hyperparameters
        if kind not in self._by_kind:
            self._drop_empty()
            self._by_kind[kind] = self._new(stack_type, sizes, membership.hyperparameters)
        stack = self._by_kind[kind]
        free = self._free[id(stack)]
        if not free:
            raise CohortFullError(f"all {self.settings.width} slots for {membership.student} are taken")
        slot = free.pop(0)
        try:
            return seat_type(membership, stack, slot)
        except Exception:
            free.append(slot)
            raise

    def leave(self, seat: Seat[Any, Any]) -> None:
        """Free the slot of `seat`."""
        seat.leave()
        self._free[id(seat.stack)].append(seat.slot)

    def _drop_empty(self) -> None:
        """Free the memory of stacks that nobody is in: a stack of another kind is to be made."""
        empty = [stack for stack in self.stacks if len(self._free[id(stack)]) == self.settings.width]
        for stack in empty:
            self.stacks.remove(stack)
            del self._free[id(stack)]
        self._by_kind = {kind: stack for kind, stack in self._by_kind.items() if stack in self.stacks}

    def _new(self, stack_type: type[Any], sizes: tuple[int, int], hyperparameters: Any) -> Any:
        settings = self.settings
        stack = stack_type(
            sizes,
            hyperparameters,
            settings.width,
            *((hyperparameters.buffer_size,) if stack_type is StackedSAC else ()),
            device=torch.device(settings.device),
            compiled=settings.compiled,
        )
        self.stacks.append(stack)
        self._free[id(stack)] = list(range(settings.width))
        return stack

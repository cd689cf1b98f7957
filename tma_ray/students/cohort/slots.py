"""The places of runs in a stacked learner: conversion from and to students that learn alone."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.base import update_key
from tma_ray.students.cohort.learner import StackedLearner
from tma_ray.students.cohort.ppo import PPONetworks, StackedPPO
from tma_ray.students.cohort.sac import SACNetworks, StackedSAC
from tma_ray.students.ppo import PPO
from tma_ray.students.rollout_workers import CohortFullError, JoinRequest, WorkerState
from tma_ray.students.rollout_workers.link import CohortSettings
from tma_ray.students.sac import SAC


class RunSlot(ABC):
    """A slot of a stack, with the student that owns the run's networks whenever they are not in the stack.

    That student makes the initial weights, writes and reads the files: a run may move out of a cohort and
    into one.

    Attributes:
        stack: learner of the runs like this one.
        slot: slot of the run in it.
        student: student that would learn alone.
    """

    student_type: ClassVar[type[SAC | PPO]]
    stack: StackedLearner
    student: SAC | PPO

    def __init__(self, membership: JoinRequest, stack: Any, slot: int) -> None:
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

    def weights(self) -> NDArray[np.float32]:
        """Return the parameters that the player acts with."""
        return _array(self.stack.actors([self.slot])[0])

    def reset(self) -> NDArray[np.float32]:
        """Replace networks, optimisers and stored experience by new ones; return the weights."""
        self.student.reset()
        self._enter()
        return self.weights()

    def save(self, folder: Path, state: WorkerState, incremental: bool) -> Callable[[], tuple[str, ...]]:
        """Return a function that writes the student's complete state, in any thread while the run waits."""
        self._copy_back()
        self.student.restore_experience(state.experience)
        for generator, saved in zip(self.student._generators[:2], state.generators[:2], strict=True):
            generator.bit_generator.state = saved
        return lambda: self.student.save(folder, incremental)

    def load_state(self) -> tuple[NDArray[np.float32], WorkerState]:
        """Load the state that the student has read; return the weights and the player's half."""
        self._enter()
        generators = [dict(each.bit_generator.state) for each in self.student._generators]
        return self.weights(), WorkerState(generators, self.student.experience())

    def save_policy(self, folder: Path, state: WorkerState) -> None:
        """Write the greedy policy."""
        self._copy_back()
        self.student.restore_experience(state.experience)
        self.student.save_policy(folder)

    def scalars(self) -> dict[str, float]:
        """Return figures about the last update."""
        return self.stack.figures(self.slot)


class SACSlot(RunSlot):
    """A run of SAC in a stack. The student keeps a copy of the replay, for checkpoints."""

    student_type = SAC
    stack: StackedSAC
    student: SAC

    def learn(self, experience: tuple[Any, ...], updates: int) -> None:  # noqa: D102
        self.student.replay.extend(*experience)
        self.stack.store(self.slot, *experience)
        self.stack.owe(self.slot, updates)

    def _enter(self) -> None:
        update = self.student.update
        (actor_mean, actor_square), critics = update.actor_adam.moments, update.critic_adam.moments
        networks = SACNetworks(
            _array(update.actor.values),
            _pair(update.critics.values),
            _pair(update.targets.values),
            _array(actor_mean),
            _array(actor_square),
            _pair(critics[0]),
            _pair(critics[1]),
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


class PPOSlot(RunSlot):
    """A run of PPO in a stack. Statistics and the rollout are the player's."""

    student_type = PPO
    stack: StackedPPO
    student: PPO

    def learn(self, experience: tuple[Any, ...], updates: int) -> None:  # noqa: D102
        *columns, orders = experience
        self.stack.store(self.slot, columns, orders)
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


def _array(values: torch.Tensor) -> NDArray[np.float32]:
    return values.detach().numpy(force=True)


def _pair(values: torch.Tensor) -> NDArray[np.float32]:
    """Return the parameters (2q,) of two networks in a row each (2, q)."""
    return _array(values).reshape(2, -1)


def _flat(values: NDArray[np.floating]) -> torch.Tensor:
    return torch.from_numpy(values).reshape(-1)


class LearnerPool:
    """The stacks of a learner. Runs share one if student, sizes and hyper-parameters are equal.

    Attributes:
        settings: settings of the cohort.
        stacks: stacks in the order in which they were made.
    """

    def __init__(self, settings: CohortSettings) -> None:
        self.settings = settings
        self.stacks: list[StackedLearner] = []
        self._by_kind: dict[Any, StackedLearner] = {}
        self._free: dict[int, list[int]] = {}

    def seat(self, membership: JoinRequest) -> RunSlot:
        """Return a seat for a new player.

        Raises:
            CohortFullError: all slots of its stack are taken.
        """
        settings, hyper = self.settings, membership.hyperparameters
        sizes = membership.observation_space.shape[0], membership.action_space.shape[0]
        kind = membership.student, sizes, hyper
        if kind not in self._by_kind:
            # free the memory of stacks that nobody is in
            for empty in [each for each in self.stacks if len(self._free[id(each)]) == settings.width]:
                self.stacks.remove(empty)
                del self._free[id(empty)]
            self._by_kind = {own: each for own, each in self._by_kind.items() if each in self.stacks}
            options: Any = {"device": torch.device(settings.device), "compiled": settings.compiled}
            made: StackedLearner
            if membership.student == "sac":
                made = StackedSAC(sizes, hyper, settings.width, hyper.buffer_size, **options)
            else:
                made = StackedPPO(sizes, hyper, settings.width, **options)
            self._by_kind[kind] = made
            self.stacks.append(made)
            self._free[id(made)] = list(range(settings.width))
        stack = self._by_kind[kind]
        free = self._free[id(stack)]
        if not free:
            raise CohortFullError(f"all {settings.width} slots for {membership.student} are taken")
        slot = free.pop(0)
        try:
            return (SACSlot if membership.student == "sac" else PPOSlot)(membership, stack, slot)
        except Exception:
            free.append(slot)
            raise

    def leave(self, seat: RunSlot) -> None:
        """Free the slot of `seat`."""
        seat.stack.leave(seat.slot)
        self._free[id(seat.stack)].append(seat.slot)

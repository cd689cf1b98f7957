"""Slots of runs in stacked learners, with conversion from and to ordinary students."""

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
    """Slot of a run in a stacked learner, with a student that initialises, saves and loads it."""

    student_type: ClassVar[type[SAC | PPO]]
    stack: StackedLearner
    student: SAC | PPO

    def __init__(self, request: JoinRequest, stack: Any, slot: int) -> None:
        self.stack, self.slot = stack, slot
        self._key = update_key(request.seed)
        self.student = self.student_type(
            request.observation_space, request.action_space, request.hyperparameters, request.seed
        )
        self._enter()

    @abstractmethod
    def learn(self, experience: tuple[Any, ...], updates: int) -> None:
        """Store `experience`, and add `updates` to the pending updates of the run."""

    @abstractmethod
    def _enter(self) -> None:
        """Copy the student's networks and experience into the stack."""

    @abstractmethod
    def _copy_back(self) -> None:
        """Copy the networks from the stack back into the student."""

    def weights(self) -> NDArray[np.float32]:
        """Return the actor's parameters (p,)."""
        return _array(self.stack.actors([self.slot])[0])

    def reset(self) -> NDArray[np.float32]:
        """Reset the networks, optimisers and experience, and return the new weights."""
        self.student.reset()
        self._enter()
        return self.weights()

    def save(self, folder: Path, state: WorkerState, incremental: bool) -> Callable[[], tuple[str, ...]]:
        """Copy the state into the student, and return a function that writes it to `folder`.

        Any thread may call the function while the run waits.
        """
        self._copy_back()
        self.student.restore_experience(state.experience)
        for generator, saved in zip(self.student._generators[:2], state.generators[:2], strict=True):
            generator.bit_generator.state = saved
        return lambda: self.student.save(folder, incremental)

    def load_state(self) -> tuple[NDArray[np.float32], WorkerState]:
        """Copy the student's loaded state into the stack, and return the weights and the worker's state."""
        self._enter()
        generators = [dict(rng.bit_generator.state) for rng in self.student._generators]
        return self.weights(), WorkerState(generators, self.student.experience())

    def save_policy(self, folder: Path, state: WorkerState) -> None:
        """Copy the networks and `state` into the student, and write its greedy policy to `folder`."""
        self._copy_back()
        self.student.restore_experience(state.experience)
        self.student.save_policy(folder)


class SACSlot(RunSlot):
    """Slot of a SAC run, whose student keeps a copy of the replay buffer for checkpoints."""

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
        """Return V(s) (n,) of `observations` (n, o), with noise from the student's generator."""
        return self.stack.values(self.slot, observations, self.student.value_noise(len(observations)))

    def _copy_back(self) -> None:
        update, networks = self.student.update, self.stack.networks(self.slot)
        groups = update.actor, update.critics, update.targets
        for flat, values in zip(groups, networks[:3], strict=True):
            flat.values.copy_(_flat(values))
        update.actor_adam.put(_flat(networks.actor_mean), _flat(networks.actor_square), networks.step)
        update.critic_adam.put(_flat(networks.critics_mean), _flat(networks.critics_square), networks.step)
        self.student.changed(networks.number)


class PPOSlot(RunSlot):
    """Slot of a PPO run, whose rollout worker keeps the observation statistics and the rollout."""

    student_type = PPO
    stack: StackedPPO
    student: PPO

    def learn(self, experience: tuple[Any, ...], updates: int) -> None:  # noqa: D102
        *columns, orders = experience
        self.stack.store(self.slot, columns, orders)
        assert self.stack.owed[self.slot] == updates, "workers and learners count the same updates"

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
    """Return the parameters (2q,) of two networks as an array (2, q)."""
    return _array(values).reshape(2, -1)


def _flat(values: NDArray[np.floating]) -> torch.Tensor:
    return torch.from_numpy(values).reshape(-1)


class LearnerPool:
    """Stacked learners of a cohort, one per combination of student, sizes of spaces and hyper-parameters."""

    def __init__(self, settings: CohortSettings) -> None:
        self.settings = settings
        self.stacks: list[StackedLearner] = []
        self._by_kind: dict[Any, StackedLearner] = {}
        self._free: dict[int, list[int]] = {}

    def join(self, request: JoinRequest) -> RunSlot:
        """Assign a free slot to a new run, creating its stacked learner if needed.

        Raises:
            CohortFullError: if all slots of its stack are taken.
        """
        settings, hyper = self.settings, request.hyperparameters
        sizes = request.observation_space.shape[0], request.action_space.shape[0]
        kind = request.student, sizes, hyper
        if kind not in self._by_kind:
            # release the memory of empty stacks
            for empty in [stack for stack in self.stacks if len(self._free[id(stack)]) == settings.width]:
                self.stacks.remove(empty)
                del self._free[id(empty)]
            self._by_kind = {key: stack for key, stack in self._by_kind.items() if stack in self.stacks}
            options: Any = {"device": torch.device(settings.device), "compiled": settings.compiled}
            new: StackedLearner
            if request.student == "sac":
                new = StackedSAC(sizes, hyper, settings.width, hyper.buffer_size, **options)
            else:
                new = StackedPPO(sizes, hyper, settings.width, **options)
            self._by_kind[kind] = new
            self.stacks.append(new)
            self._free[id(new)] = list(range(settings.width))
        stack = self._by_kind[kind]
        free = self._free[id(stack)]
        if not free:
            raise CohortFullError(f"all {settings.width} slots for {request.student} are taken")
        slot = free.pop(0)
        try:
            return (SACSlot if request.student == "sac" else PPOSlot)(request, stack, slot)
        except Exception:
            free.append(slot)
            raise

    def leave(self, run: RunSlot) -> None:
        """Free the slot of a run."""
        run.stack.leave(run.slot)
        self._free[id(run.stack)].append(run.slot)

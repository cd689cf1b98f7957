"""The stacks of a cohort: one for each kind of student, made when its first run joins."""

from __future__ import annotations

from typing import Any

import torch

from tma_ray.students.cohort.ppo import StackedPPO
from tma_ray.students.cohort.sac import StackedSAC
from tma_ray.students.cohort.seats import PPOSeat, SACSeat, Seat
from tma_ray.students.players import CohortFullError, Membership
from tma_ray.students.players.settings import CohortSettings

KINDS: dict[str, tuple[type[Any], type[Seat[Any, Any]]]] = {
    "ppo": (StackedPPO, PPOSeat),
    "sac": (StackedSAC, SACSeat),
}
"""Stacked learner, and the seats in it, by the student's name."""


class Stacks:
    """The stacks of a learner. Runs share one if student, sizes and hyper-parameters are equal.

    Args:
        settings: of the cohort.

    Attributes:
        settings: as given.
        stacks: in the order in which they were made.
    """

    def __init__(self, settings: CohortSettings) -> None:
        self.settings = settings
        self.stacks: list[Any] = []
        self._by_kind: dict[Any, Any] = {}
        self._free: dict[int, list[int]] = {}

    def seat(self, membership: Membership) -> Seat[Any, Any]:
        """Returns a seat for a new player.

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
        """Frees the slot of `seat`."""
        seat.leave()
        self._free[id(seat.stack)].append(seat.slot)

    def _drop_empty(self) -> None:
        """Frees the memory of stacks that nobody is in: a stack of another kind is to be made."""
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

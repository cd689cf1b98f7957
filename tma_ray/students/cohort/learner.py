"""The slots of a stacked learner: who is in which, what is due, and the execution of updates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.cohort.execution import Repeated
from tma_ray.students.cohort.transfer import upload
from tma_ray.students.hyperparameters import MatmulPrecision


class Stack(NamedTuple):
    """Parameters of all runs, or a moment of their gradient, in a padded layout.

    Attributes:
        memory: one row or more per slot (k, ..., p).
        places: of the parameters without padding in a row.
    """

    memory: torch.Tensor
    places: torch.Tensor


class Device(NamedTuple):
    """Place of computation and the types there.

    Attributes:
        device: where memory is and updates are executed.
        dtype: of parameters, losses and optimisers.
        precision: of matrix products.
    """

    device: torch.device
    dtype: torch.dtype
    precision: MatmulPrecision


class StackedLearner(ABC):
    """Learner of many runs, each in a slot: what a run learns does not depend on the others by a bit.

    An update trains the runs that owe one, always at the full width: idle slots take part in the products,
    and nothing of them changes.

    Args:
        width: number of slots k.
        place: where to learn, and in which types.

    Attributes:
        owed: updates that are due, by slot (k,).
    """

    def __init__(self, width: int, place: Device) -> None:
        self.owed = np.zeros(width, dtype=np.int64)
        self._device, self._dtype = place.device, place.dtype
        self._owed = torch.zeros(width, dtype=torch.int64, device=self._device)
        self._repeated = Repeated(self._advance_once, place.precision, self._device)

    def leave(self, slot: int) -> None:
        """Makes `slot` idle: it owes nothing, has no experience, and all its parameters are 0."""
        self.owed[slot] = 0
        self._owed[slot].fill_(0)
        for memory, _ in self._stacks():
            memory.detach()[slot].zero_()
        for counts in self._counters():
            counts[slot].fill_(0)

    def owe(self, slot: int, updates: int) -> None:
        """Adds `updates` to what is due to the run in `slot`."""
        self.owed[slot] += updates
        self._owed[slot].add_(updates)

    def advance(self, updates: int) -> None:
        """Makes up to `updates` updates, each of all runs that owe one; a GPU is not waited for."""
        updates = min(updates, int(self.owed.max()))
        if not updates:
            return
        if self._repeated.wants_capture:
            owed = self._owed.clone()
            self._owed.zero_()  # nothing changes by the executions before the capture
            self._repeated.capture()
            self._owed.copy_(owed)
        self._repeated(updates)
        np.maximum(self.owed - updates, 0, out=self.owed)

    def actors(self, slots: Sequence[int]) -> torch.Tensor:
        """Returns what the runs in `slots` act by, without padding and on the device (len(slots), p)."""
        memory, places = self._stacks()[0]
        rows = upload(np.array(slots, dtype=np.int64), self._device)
        return memory.detach().index_select(0, rows).index_select(1, places)

    def _write(self, slot: int, networks: Sequence[Any]) -> None:
        """Takes over arrays for the stacks, without padding, and numbers for the counters."""
        stacks, counters = self._stacks(), self._counters()
        for (memory, places), values in zip(stacks, networks[: len(stacks)], strict=True):
            memory.detach()[slot][..., places] = upload(values, self._device).to(self._dtype)
        for counts, number in zip(counters, networks[len(stacks) :], strict=True):
            counts[slot].fill_(number)

    def _read(self, slot: int) -> list[Any]:
        """Returns what `_write` takes over."""
        arrays = [memory.detach()[slot][..., places].cpu().numpy() for memory, places in self._stacks()]
        return [*arrays, *(int(counts[slot]) for counts in self._counters())]

    def _rows(self, values: NDArray[np.floating]) -> torch.Tensor:
        """Returns `values` on the device, in the type of the parameters."""
        return upload(values, self._device).to(self._dtype)

    @abstractmethod
    def _stacks(self) -> list[Stack]:
        """Returns all that is learned; first what runs act by."""

    @abstractmethod
    def _counters(self) -> list[torch.Tensor]:
        """Returns the numbers (k,) that belong to what is learned."""

    @abstractmethod
    def _advance_once(self) -> None:
        """Makes one update; reads and writes nothing of the host."""

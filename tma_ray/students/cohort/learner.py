"""The slots of a stacked learner: who is in which, what is due, and the execution of updates."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from typing import Any, Self, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.cohort.device import Repeated, upload
from tma_ray.students.hyperparameters import MatmulPrecision


def batching_is_faster(device: torch.device, precision: MatmulPrecision, compiled: bool | str) -> bool:
    """Return True if one product of all runs is faster than one for each: not on a processor in float32."""
    return device.type != "cpu" or bool(compiled) or precision == MatmulPrecision.MEDIUM


class StackedLearner(ABC):
    """Learner of many runs, each in a slot: what a run learns does not depend on the others by a bit.

    An update trains all runs with updates due, at the full width: idle slots take part in the products,
    and nothing of them changes. Where that does not pay, one run is updated after the other, and idle slots
    cost nothing.

    Args:
        width: number of slots k.
        device: device of memory and updates.
        dtype: data type of parameters, losses and optimisers.
        precision: precision of matrix products.
        compiled: see `compile_if`.

    Attributes:
        owed: number of updates that are due, by slot (k,).
        together: runs are updated together, not one after the other.
    """

    def __init__(
        self,
        width: int,
        device: torch.device,
        dtype: torch.dtype,
        precision: MatmulPrecision,
        compiled: bool | str,
    ) -> None:
        self.owed = np.zeros(width, dtype=np.int64)
        self._device, self._dtype, self._precision = device, dtype, precision
        self._owed = torch.zeros(width, dtype=torch.int64, device=device)
        self._repeated = Repeated(self._advance_once, precision, device)
        self.together = batching_is_faster(device, precision, compiled)
        self._rows: dict[int, Repeated] = {}

    def leave(self, slot: int) -> None:
        """Make `slot` idle: no updates due, no experience, all its parameters 0."""
        self.owed[slot] = 0
        self._owed[slot].fill_(0)
        for memory, _ in self._stacks():
            memory.detach()[slot].zero_()
        for counts in self._counters():
            counts[slot].fill_(0)

    def owe(self, slot: int, updates: int) -> None:
        """Add `updates` to those due to the run in `slot`."""
        self.owed[slot] += updates
        self._owed[slot].add_(updates)

    def advance(self, updates: int, slots: Sequence[int] | None = None) -> None:
        """Make up to `updates` updates of runs that have any due; returns without waiting for a GPU.

        Args:
            updates: updates of each run, at most.
            slots: slots of the runs, by default all; those that are updated together can only be named all.
        """
        if not self.together:
            for slot in range(len(self.owed)) if slots is None else slots:
                if slot not in self._rows:
                    once = self._row(slot)._advance_once
                    self._rows[slot] = Repeated(once, self._precision, self._device)
                due = min(updates, int(self.owed[slot]))
                self._rows[slot](due)
                self.owed[slot] -= due
            return
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
        """Return the actors of the runs in `slots`, without padding and on the device (len(slots), p)."""
        memory, places = self._stacks()[0]
        rows = upload(np.array(slots, dtype=np.int64), self._device)
        return memory.detach().index_select(0, rows).index_select(1, places)

    def _write(self, slot: int, networks: Sequence[Any]) -> None:
        """Load arrays for the stacks, without padding, and numbers for the counters."""
        stacks, counters = self._stacks(), self._counters()
        for (memory, places), values in zip(stacks, networks[: len(stacks)], strict=True):
            memory.detach()[slot][..., places] = upload(values, self._device).to(self._dtype)
        for counts, number in zip(counters, networks[len(stacks) :], strict=True):
            counts[slot].fill_(number)

    def _read(self, slot: int) -> list[Any]:
        """Return the arrays and counters that `_write` loads."""
        arrays = [memory.detach()[slot][..., places].cpu().numpy() for memory, places in self._stacks()]
        return [*arrays, *(int(counts[slot]) for counts in self._counters())]

    def _on_device(self, values: NDArray[np.floating]) -> torch.Tensor:
        """Return `values` on the device, in the type of the parameters."""
        return upload(values, self._device).to(self._dtype)

    @abstractmethod
    def _stacks(self) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """Return all learned parameters in padded layouts, those of acting first.

        Each is memory with one row or more per slot (k, ..., p), and the places of the parameters without
        padding in a row.
        """

    @abstractmethod
    def figures(self, slot: int) -> dict[str, float]:
        """Return figures about the last updates of the run in `slot`."""

    @abstractmethod
    def _counters(self) -> list[torch.Tensor]:
        """Return the numbers (k,) that belong to what is learned."""

    @abstractmethod
    def _row(self, slot: int) -> Self:
        """Return a learner of the run in `slot` alone, over the same memory."""

    @abstractmethod
    def _advance_once(self) -> None:
        """Make one update; reads and write nothing of the host."""


T = TypeVar("T")


def narrowed(owner: T, slot: int, *names: str) -> T:
    """Return a shallow copy of `owner` with views of one slot's row (1, ...) of the tensors `names`."""
    own = copy(owner)
    for name in names:
        setattr(own, name, getattr(owner, name)[slot : slot + 1])
    return own


def leaf(parameters: torch.Tensor, slot: int) -> torch.Tensor:
    """Return the row of a slot as a leaf of autograd (1, ...), in the same memory."""
    return parameters.detach()[slot : slot + 1].requires_grad_()

"""Base class of stacked learners that update many runs at once."""

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
    """Return True if updating runs together is faster than updating them one after the other.

    This is always the case, except in eager float32 on a CPU.
    """
    return device.type != "cpu" or bool(compiled) or precision == MatmulPrecision.MEDIUM


class StackedLearner(ABC):
    """Learner of many runs, one per slot; the results of a run are bitwise independent of other runs.

    An update trains all runs with updates due, at the full width: idle slots take part in the products
    without changing. Where that does not pay, runs are updated one after the other.

    Attributes:
        owed: number of updates due, by slot (k,).
        together: True if runs are updated together, not one after the other.
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
        """Clear `slot`: discard pending updates and experience, and set all parameters to 0."""
        self.owed[slot] = 0
        self._owed[slot].fill_(0)
        for memory, _ in self._parameter_groups():
            memory.detach()[slot].zero_()
        for counts in self._counters():
            counts[slot].fill_(0)

    def owe(self, slot: int, updates: int) -> None:
        """Add `updates` to the pending updates of the run in `slot`."""
        self.owed[slot] += updates
        self._owed[slot].add_(updates)

    def advance(self, updates: int, slots: Sequence[int] | None = None) -> None:
        """Perform at most `updates` pending updates per run, without waiting for a GPU.

        Runs that are updated one after the other can be restricted to `slots`.
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
            self._owed.zero_()  # so that warm-up executions change nothing
            self._repeated.capture()
            self._owed.copy_(owed)
        self._repeated(updates)
        np.maximum(self.owed - updates, 0, out=self.owed)

    def actors(self, slots: Sequence[int]) -> torch.Tensor:
        """Return the actors' parameters (n, p) of the runs in `slots`, unpadded and on the device."""
        memory, columns = self._parameter_groups()[0]
        rows = upload(np.array(slots, dtype=np.int64), self._device)
        return memory.detach().index_select(0, rows).index_select(1, columns)

    def _write(self, slot: int, networks: Sequence[Any]) -> None:
        """Load a run's `networks`, unpadded arrays followed by counters, into `slot`."""
        stacks, counters = self._parameter_groups(), self._counters()
        for (memory, columns), values in zip(stacks, networks[: len(stacks)], strict=True):
            memory.detach()[slot][..., columns] = upload(values, self._device).to(self._dtype)
        for counts, number in zip(counters, networks[len(stacks) :], strict=True):
            counts[slot].fill_(number)

    def _read(self, slot: int) -> list[Any]:
        """Return the arrays and counters in `slot`, in the form that `_write` loads."""
        arrays = [
            memory.detach()[slot][..., columns].cpu().numpy() for memory, columns in self._parameter_groups()
        ]
        return [*arrays, *(int(counts[slot]) for counts in self._counters())]

    def _on_device(self, values: NDArray[np.floating]) -> torch.Tensor:
        """Return `values` on the device, in the data type of the parameters."""
        return upload(values, self._device).to(self._dtype)

    @abstractmethod
    def _parameter_groups(self) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """Return pairs of a parameter tensor (k, ..., p) and its unpadded columns' indices, actor first."""

    @abstractmethod
    def metrics(self, slot: int) -> dict[str, float]:
        """Return metrics of the last updates of the run in `slot`."""

    @abstractmethod
    def _counters(self) -> list[torch.Tensor]:
        """Return the counters (k,) that are saved with the parameters."""

    @abstractmethod
    def _row(self, slot: int) -> Self:
        """Return a view of this learner, sharing its memory, restricted to the run in `slot`."""

    @abstractmethod
    def _advance_once(self) -> None:
        """Run one update on the device, without touching host memory."""


OwnerT = TypeVar("OwnerT")


def narrowed(owner: OwnerT, slot: int, *names: str) -> OwnerT:
    """Return a shallow copy of `owner` with its tensors `names` narrowed to the row of `slot` (1, ...)."""
    narrow = copy(owner)
    for name in names:
        setattr(narrow, name, getattr(owner, name)[slot : slot + 1])
    return narrow


def leaf(parameters: torch.Tensor, slot: int) -> torch.Tensor:
    """Return the row (1, ...) of `slot` as an autograd leaf that shares the memory of `parameters`."""
    return parameters.detach()[slot : slot + 1].requires_grad_()

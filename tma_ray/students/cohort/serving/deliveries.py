"""Weights on their way from the learner's device to the players."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

import torch

T = TypeVar("T")


class Delivery(NamedTuple, Generic[T]):
    """A copy to the host that may still be under way.

    Attributes:
        receivers: of the rows, in order.
        rows: memory of the host (n, ...).
        arrival: recorded after the copy on a GPU; None if it has arrived.
    """

    receivers: Sequence[T]
    rows: torch.Tensor
    arrival: torch.cuda.Event | None

    @classmethod
    def of(cls, receivers: Sequence[T], rows: torch.Tensor) -> Delivery[T]:
        """Starts to copy `rows` (n, ...) from their device."""
        if rows.device.type != "cuda":
            return cls(receivers, rows.to("cpu"), None)
        memory = torch.empty(rows.shape, dtype=rows.dtype, pin_memory=True)
        memory.copy_(rows, non_blocking=True)
        return cls(receivers, memory, recorded())

    @property
    def arrived(self) -> bool:
        """True if the rows may be read."""
        return self.arrival is None or bool(self.arrival.query())  # type: ignore[no-untyped-call]


def recorded() -> torch.cuda.Event:
    """Returns a mark in the work that the GPU was asked to do; who waits for it leaves the processor."""
    event = torch.cuda.Event(blocking=True)  # type: ignore[no-untyped-call]
    event.record()
    return event


class Pace:
    """Holds the host back when it has asked a GPU for more than it has done.

    Work that is asked for too early would keep what comes later waiting.

    Args:
        device: where the work is done.
        most: pieces of work that may be under way.
    """

    def __init__(self, device: torch.device, most: int) -> None:
        self._waits, self._most = device.type == "cuda", most
        self._events: deque[torch.cuda.Event] = deque()

    def keep(self) -> None:
        """Marks the end of a piece of work, and waits while too many are under way."""
        if not self._waits:
            return
        self._events.append(recorded())
        if len(self._events) > self._most:
            self._events.popleft().synchronize()

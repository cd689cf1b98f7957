"""Memory that a player and its learner share, so that neither waits for the other to empty a socket."""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterable
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ALIGNMENT = 64
"""Of arrays in the memory, bytes."""


class Posted(NamedTuple):
    """An array in a mailbox, as a message names it.

    Attributes:
        offset: of its first byte.
        dtype: its type, as numpy writes it.
        shape: its shape.
    """

    offset: int
    dtype: str
    shape: tuple[int, ...]


class Mailbox:
    """Anonymous memory for the arrays of one message at a time, in either direction.

    It belongs to no folder and ends with the processes that have it.

    Args:
        descriptor: of the memory; closed with the mailbox.
        size: bytes.
    """

    def __init__(self, descriptor: int, size: int) -> None:
        self._descriptor, self.size = descriptor, size
        self._memory = np.frombuffer(mmap.mmap(descriptor, size), dtype=np.uint8)

    @classmethod
    def create(cls, size: int) -> Mailbox:
        """Returns a new mailbox with room for `size` bytes."""
        descriptor = os.memfd_create("mailbox")
        os.ftruncate(descriptor, size)
        return cls(descriptor, size)

    @classmethod
    def receive(cls, connection: Connection, size: int) -> Mailbox:
        """Returns the mailbox that the other side of a connection offers."""
        return cls(recv_handle(connection), size)

    def offer(self, connection: Connection) -> None:
        """Gives the other side of a connection this mailbox."""
        send_handle(connection, self._descriptor, None)

    def post(self, parts: Iterable[Any]) -> tuple[Any, ...]:
        """Returns `parts` as a message has them: arrays are in the memory, all else as it is."""
        posted, offset = [], 0
        for part in parts:
            if isinstance(part, np.ndarray):
                place = Posted(offset, part.dtype.str, part.shape)
                self._view(place)[...] = part
                offset += room_for([part])
                posted.append(place)
            else:
                posted.append(part)
        return tuple(posted)

    def collect(self, posted: Iterable[Any]) -> tuple[Any, ...]:
        """Returns copies of what the other side has posted."""
        return tuple(self._view(part).copy() if isinstance(part, Posted) else part for part in posted)

    def close(self) -> None:
        """Gives the descriptor back; the memory goes with its last view."""
        os.close(self._descriptor)

    def _view(self, place: Posted) -> NDArray[Any]:
        dtype = np.dtype(place.dtype)
        size = dtype.itemsize * int(np.prod(place.shape, dtype=np.int64))
        return self._memory[place.offset : place.offset + size].view(dtype).reshape(place.shape)


def room_for(parts: Iterable[Any]) -> int:
    """Returns the bytes that a mailbox needs for the arrays of a message."""
    sizes = (part.nbytes for part in parts if isinstance(part, np.ndarray))
    return sum(-(-size // ALIGNMENT) * ALIGNMENT for size in sizes)


def can_share() -> bool:
    """Tells whether this system has memory without a name, as Linux does."""
    return hasattr(os, "memfd_create")

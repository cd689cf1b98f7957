"""Connection of a rollout worker to the learner of its cohort, importable without torch."""

import mmap
import os
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass, field
from multiprocessing.connection import Client, Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from tma_ray.support.validation import check_fields, check_whole

ALIGNMENT = 64  # alignment of arrays in a shared buffer, in bytes


class ArrayRef(NamedTuple):
    """Reference to an array in a shared buffer, by offset in bytes, numpy type name and shape."""

    offset: int
    dtype: str
    shape: tuple[int, ...]


class SharedBuffer:
    """Anonymous shared memory for the arrays of one message at a time, in either direction.

    It has no file and is freed with the last process that maps it.
    """

    def __init__(self, descriptor: int, size: int) -> None:
        self._descriptor, self.size = descriptor, size
        self._memory = np.frombuffer(mmap.mmap(descriptor, size), dtype=np.uint8)

    @classmethod
    def create(cls, size: int) -> "SharedBuffer":
        """Return a new shared buffer of `size` bytes."""
        descriptor = os.memfd_create("tma_ray")
        os.ftruncate(descriptor, size)
        return cls(descriptor, size)

    @classmethod
    def receive(cls, connection: Connection, size: int) -> "SharedBuffer":
        """Return the buffer of `size` bytes that the other end of `connection` sent with `offer`."""
        return cls(recv_handle(connection), size)

    def offer(self, connection: Connection) -> None:
        """Send this buffer to the other end of `connection`."""
        send_handle(connection, self._descriptor, None)

    def post(self, values: Iterable[Any]) -> tuple[Any, ...]:
        """Copy arrays in `values` to the buffer, and return `values` with arrays replaced by references."""
        message, offset = list(values), 0
        for index, value in enumerate(message):
            if isinstance(value, np.ndarray):
                message[index] = reference = ArrayRef(offset, value.dtype.str, value.shape)
                self._view(reference)[...] = value
                offset += buffer_size([value])
        return tuple(message)

    def collect(self, message: Iterable[Any]) -> tuple[Any, ...]:
        """Return the values of a `message`, with copies of the arrays in place of references."""
        return tuple(self._view(value).copy() if isinstance(value, ArrayRef) else value for value in message)

    def close(self) -> None:
        """Close the descriptor; the memory is freed with its last view."""
        os.close(self._descriptor)

    def _view(self, reference: ArrayRef) -> NDArray[Any]:
        dtype, start = np.dtype(reference.dtype), reference.offset
        size = dtype.itemsize * int(np.prod(reference.shape, dtype=np.int64))
        return self._memory[start : start + size].view(dtype).reshape(reference.shape)


def buffer_size(values: Iterable[Any]) -> int:
    """Return the size in bytes of a buffer for the arrays in `values`."""
    sizes = (value.nbytes for value in values if isinstance(value, np.ndarray))
    return sum(-(-size // ALIGNMENT) * ALIGNMENT for size in sizes)


def has_shared_memory() -> bool:
    """Return True if this system has anonymous shared memory (Linux)."""
    return hasattr(os, "memfd_create")


Weights = NDArray[np.float32]  # parameters of the network that computes actions (p,)


class LearnerError(RuntimeError):
    """Error that occurred in the learner during a request, with its traceback."""


class CohortFullError(LearnerError):
    """Error raised if a cohort has no free slot."""


class LearnerLostError(ConnectionError):
    """Error raised if the learner's process or machine has ended; the run can be resumed."""


@dataclass(frozen=True)
class Learner:
    """Address of a cohort's learner, with the path of its socket on this machine and the shared secret."""

    address: str
    key: bytes = field(repr=False)


class JoinRequest(NamedTuple):
    """Request by a rollout worker to join a cohort."""

    student: str
    observation_space: spaces.Box
    action_space: spaces.Box
    hyperparameters: Any
    seed: np.random.SeedSequence


class WorkerState(NamedTuple):
    """State of a rollout worker, which the learner saves with the networks.

    Attributes:
        generators: states of the generators of exploration, mini-batches and state values.
        experience: counters, statistics and stored steps by name.
    """

    generators: list[dict[str, Any]]
    experience: dict[str, Any]


class LearnerLink:
    """Blocking connection of a rollout worker to its learner, over a local socket.

    Closing it, or ending the process, leaves the cohort. Experience and weights are in shared memory where
    the system has it.

    Raises:
        LearnerError: if the learner rejects a request or fails; any method may raise it.
        LearnerLostError: if the learner does not listen or is gone; any method may raise it.
    """

    def __init__(self, learner: Learner) -> None:
        try:
            self._connection = Client(learner.address, family="AF_UNIX", authkey=learner.key)
        except (OSError, EOFError) as error:
            raise LearnerLostError(f"no learner listens at {learner.address}") from error
        self._buffer: SharedBuffer | None = None
        self._weights_size = 0

    def close(self) -> None:
        """Leave the cohort."""
        self._connection.close()
        self._drop_buffer()

    def _drop_buffer(self) -> None:
        if self._buffer is not None:
            self._buffer.close()
            self._buffer = None

    def join(self, request: JoinRequest) -> Weights:
        """Join the cohort, and return the initial weights."""
        weights: Weights = self.ask("join", request)
        self._weights_size = buffer_size([weights])
        return weights

    def learn(self, experience: tuple[Any, ...], updates: int) -> Weights | None:
        """Send experience, wait for the `updates` due, and return new weights, or None if none are due."""
        weights: Weights | None
        if not has_shared_memory():
            weights = self.ask("learn", experience, updates)
            return weights
        size = max(buffer_size(experience), self._weights_size)
        if self._buffer is None or self._buffer.size < size:
            self._drop_buffer()
            self._buffer = SharedBuffer.create(size + size // 2)
            self.ask("share", self._buffer.size, follows=self._buffer.offer)
        reply = self.ask("learn", self._buffer.post(experience), updates)
        (weights,) = self._buffer.collect((reply,))
        return weights

    def ask(self, request: str, *arguments: Any, follows: Callable[[Any], None] = lambda _: None) -> Any:
        """Send a request, call `follows` with the connection to send further data, and return the reply.

        Requests, with their arguments and replies, are

        - ``values``, observations (n, o): state values (n,);
        - ``reset``: weights of new networks;
        - ``save``, folder, `WorkerState`, True if incremental: names of the files left out;
        - ``load``, folder: weights and `WorkerState`;
        - ``save_policy``, folder, `WorkerState`: None.
        """
        try:
            self._connection.send((request, *arguments))
            follows(self._connection)
            succeeded, result = self._connection.recv()
        except (OSError, EOFError) as error:
            raise LearnerLostError(f"the learner of the cohort ended during {request!r}") from error
        if isinstance(result, LearnerError):
            raise result
        if not succeeded:
            raise LearnerError(f"the learner of the cohort failed:\n{result}")
        return result


def ask_learner(learner: Learner, request: str) -> dict[str, Any]:
    """Send the learner a request, "account" or "hardware", and return the reply.

    The account has the seconds spent on each part of the work and numbers of updates, the hardware the
    device, GPU and width that results depend on.

    Raises:
        LearnerLostError: if the learner does not answer.
    """
    with closing(LearnerLink(learner)) as link:
        entries: dict[str, Any] = link.ask(request)
    return entries


@dataclass(frozen=True)
class CohortSettings:
    """Settings of the learner of a cohort.

    Attributes:
        device: torch device of the learner.
        width: slots of each stack of equal students, which are updated together; results depend on it up to
            rounding.
        compiled: True, or a compiler mode, to compile updates, which takes half a minute and pays on a GPU.
        threads: torch threads on a CPU.
    """

    device: str = "cpu"
    width: int = 48
    compiled: bool | str = False
    threads: int = 1

    def __post_init__(self) -> None:
        check_fields(self)
        check_whole("width", self.width, 1)
        check_whole("threads", self.threads, 1)

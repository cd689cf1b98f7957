"""The connection of a player to the learner of its cohort. Imports no torch."""

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

ALIGNMENT = 64  # of arrays in the memory, bytes


class ArrayRef(NamedTuple):
    """An array in a mailbox, as a message names it.

    Attributes:
        offset: offset of its first byte.
        dtype: its type, as numpy writes it.
        shape: its shape.
    """

    offset: int
    dtype: str
    shape: tuple[int, ...]


class SharedBuffer:
    """Anonymous memory for the arrays of one message at a time, in either direction.

    It belongs to no folder and ends with the processes that have it.

    Args:
        descriptor: descriptor of the memory; closed with the mailbox.
        size: bytes.
    """

    def __init__(self, descriptor: int, size: int) -> None:
        self._descriptor, self.size = descriptor, size
        self._memory = np.frombuffer(mmap.mmap(descriptor, size), dtype=np.uint8)

    @classmethod
    def create(cls, size: int) -> "SharedBuffer":
        """Return a new mailbox with room for `size` bytes."""
        descriptor = os.memfd_create("mailbox")
        os.ftruncate(descriptor, size)
        return cls(descriptor, size)

    @classmethod
    def receive(cls, connection: Connection, size: int) -> "SharedBuffer":
        """Return the mailbox that the other side of a connection offers."""
        return cls(recv_handle(connection), size)

    def offer(self, connection: Connection) -> None:
        """Send this mailbox to the other side of a connection."""
        send_handle(connection, self._descriptor, None)

    def post(self, parts: Iterable[Any]) -> tuple[Any, ...]:
        """Return `parts` for a message, with arrays replaced by their places in the mailbox."""
        posted, offset = list(parts), 0
        for index, part in enumerate(posted):
            if isinstance(part, np.ndarray):
                posted[index] = place = ArrayRef(offset, part.dtype.str, part.shape)
                self._view(place)[...] = part
                offset += room_for([part])
        return tuple(posted)

    def collect(self, posted: Iterable[Any]) -> tuple[Any, ...]:
        """Return copies of what the other side has posted."""
        return tuple(self._view(part).copy() if isinstance(part, ArrayRef) else part for part in posted)

    def close(self) -> None:
        """Close the descriptor; the memory is freed with its last view."""
        os.close(self._descriptor)

    def _view(self, place: ArrayRef) -> NDArray[Any]:
        dtype = np.dtype(place.dtype)
        size = dtype.itemsize * int(np.prod(place.shape, dtype=np.int64))
        return self._memory[place.offset : place.offset + size].view(dtype).reshape(place.shape)


def room_for(parts: Iterable[Any]) -> int:
    """Return the bytes that a mailbox needs for the arrays of a message."""
    sizes = (part.nbytes for part in parts if isinstance(part, np.ndarray))
    return sum(-(-size // ALIGNMENT) * ALIGNMENT for size in sizes)


def can_share() -> bool:
    """Return True if this system has memory without a name, as Linux does."""
    return hasattr(os, "memfd_create")


Weights = NDArray[np.float32]  # parameters that a player acts with (p,), in the layout of its network


class LearnerError(RuntimeError):
    """Failed request to the learner; the message has its traceback."""


class CohortFullError(LearnerError):
    """Cohort without a free slot; one may become free soon."""


class LearnerLostError(ConnectionError):
    """Lost learner, whose process or machine has ended; the run can be resumed."""


@dataclass(frozen=True)
class Learner:
    """Address of the learner of a cohort on this machine.

    Attributes:
        address: path of its socket.
        key: secret that both sides prove to know; never shown.
    """

    address: str
    key: bytes = field(repr=False)


class JoinRequest(NamedTuple):
    """Description of a player that joins, for the learner.

    Attributes:
        student: name in the student registry.
        observation_space: a one-dimensional box.
        action_space: a bounded one-dimensional box.
        hyperparameters: hyper-parameters of the student.
        seed: source of all the student's randomness.
    """

    student: str
    observation_space: spaces.Box
    action_space: spaces.Box
    hyperparameters: Any
    seed: np.random.SeedSequence


class WorkerState(NamedTuple):
    """The player's half of a student's state, which the learner writes together with its own.

    Attributes:
        generators: states of exploration, mini-batches and state values, in this order.
        experience: counters, statistics and steps, by the name that the student's own code gives them.
    """

    generators: list[dict[str, Any]]
    experience: dict[str, Any]


class LearnerLink:
    """The learning half of a student, over a socket of this machine.

    It leaves the cohort when it is closed or its process ends. Experience and weights are in memory that both
    sides share, where the system has such memory. Every call returns when it is done.

    Raises:
        LearnerError: the learner refuses any of the calls, or fails.
        LearnerLostError: nothing listens there, or the learner is gone, at any of the calls.
    """

    def __init__(self, learner: Learner) -> None:
        try:
            self._connection = Client(learner.address, family="AF_UNIX", authkey=learner.key)
        except (OSError, EOFError) as error:
            raise LearnerLostError(f"no learner listens at {learner.address}") from error
        self._mailbox: SharedBuffer | None = None
        self._weights_size = 0

    def close(self) -> None:
        """Leave the cohort."""
        self._connection.close()
        self._drop_mailbox()

    def _drop_mailbox(self) -> None:
        if self._mailbox is not None:
            self._mailbox.close()
            self._mailbox = None

    def join(self, membership: JoinRequest) -> Weights:
        """Take a slot of the cohort; return the initial weights."""
        weights: Weights = self.ask("join", membership)
        self._weights_size = room_for([weights])
        return weights

    def learn(self, experience: tuple[Any, ...], updates: int) -> Weights | None:
        """Hand over experience and make the updates that are due.

        Returns:
            The new weights; None without updates.
        """
        weights: Weights | None
        if not can_share():
            weights = self.ask("learn", experience, updates)
            return weights
        size = max(room_for(experience), self._weights_size)
        if self._mailbox is None or self._mailbox.size < size:
            self._drop_mailbox()
            self._mailbox = SharedBuffer.create(size + size // 2)
            self.ask("share", self._mailbox.size, follows=self._mailbox.offer)
        reply = self.ask("learn", self._mailbox.post(experience), updates)
        (weights,) = self._mailbox.collect((reply,))
        return weights

    def ask(self, request: str, *arguments: Any, follows: Callable[[Any], None] = lambda _: None) -> Any:
        """Return the reply to a request, after which `follows` may send more over the connection.

        Further requests of a player, with their arguments and replies, are

        - ``values``, observations (n, o): state values (n,);
        - ``reset``: the weights of new networks;
        - ``save``, folder, `WorkerState`, whether it is incremental: names of the files left out;
        - ``load``, folder: weights and `WorkerState`;
        - ``save_policy``, folder, `WorkerState`: None;
        - ``scalars``: figures about the last update.
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
    """Return what a learner says of itself without a player.

    Its "account" is the time of each part of its work, s, and numbers of updates; its "hardware" are device,
    GPU and width, on which results depend to rounding, for a fingerprint.

    Raises:
        LearnerLostError: it does not answer.
    """
    with closing(LearnerLink(learner)) as link:
        entries: dict[str, Any] = link.ask(request)
    return entries


@dataclass(frozen=True)
class CohortSettings:
    """Settings of the learner of a cohort.

    Attributes:
        device: torch's name of where it learns.
        width: slots of each stack of equal students, which are updated together; part of what a result
            depends on, to rounding.
        compiled: updates are compiled, which takes half a minute and pays on a GPU; a text is the mode of
            the compiler.
        threads: torch's threads on a CPU.
    """

    device: str = "cpu"
    width: int = 48
    compiled: bool | str = False
    threads: int = 1

    def __post_init__(self) -> None:
        check_fields(self)
        check_whole("width", self.width, 1)
        check_whole("threads", self.threads, 1)

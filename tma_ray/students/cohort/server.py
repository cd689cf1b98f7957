"""The learner of a cohort: receives experience from players, makes the updates due, returns weights."""

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection, Listener, Pipe, wait
from pathlib import Path
from typing import Any, NamedTuple

import torch

from tma_ray.students.cohort.slots import LearnerPool, RunSlot
from tma_ray.students.rollout_workers import CohortFullError, JoinRequest, Learner, WorkerState
from tma_ray.students.rollout_workers.link import CohortSettings, SharedBuffer


def recorded() -> torch.cuda.Event:
    """Return an event recorded on the GPU's stream; waiting for it leaves the processor idle."""
    event = torch.cuda.Event(blocking=True)  # type: ignore[no-untyped-call]
    event.record()
    return event


class Delivery(NamedTuple):
    """A copy to the host that may still be under way.

    Attributes:
        receivers: receivers of the rows, in order.
        rows: memory of the host (n, ...).
        arrival: recorded after the copy on a GPU; None if it has arrived.
    """

    receivers: Sequence[Connection]
    rows: torch.Tensor
    arrival: torch.cuda.Event | None

    @classmethod
    def of(cls, receivers: Sequence[Connection], rows: torch.Tensor) -> "Delivery":
        """Start to copy `rows` (n, ...) from their device."""
        if rows.device.type != "cuda":
            return cls(receivers, rows.to("cpu"), None)
        memory = torch.empty(rows.shape, dtype=rows.dtype, pin_memory=True)
        memory.copy_(rows, non_blocking=True)
        return cls(receivers, memory, recorded())


AT_ONCE = 2  # threads: checkpoints of so many runs are written or read at a time
UNDER_WAY = 2  # pieces of work that a GPU may have been asked for: more would keep what comes later waiting
MOST_AT_ONCE = 8  # updates between two looks at what players ask
DELIVERY_SECONDS = 0.0005  # time between two looks at weights that are under way from a GPU, s
_LATER = object()  # stands for a reply that follows when the updates are made


class LearnerServer:
    """Server of the players that connect, each over its own connection, one request at a time.

    A player gets its weights as soon as its updates are made; in between the learner goes on
    with others. A player that leaves or dies frees its slot.

    Attributes:
        account: seconds spent at each part of the work, and numbers of updates.
        turned_at: time of the last look at what players ask, on the monotonic clock, s.
    """

    def __init__(self, learner: Learner, settings: CohortSettings) -> None:
        torch.set_num_threads(settings.threads)
        self._stacks = LearnerPool(settings)
        self._work: deque[torch.cuda.Event] = deque()
        self._seats: dict[Connection, RunSlot] = {}
        self._mailboxes: dict[Connection, SharedBuffer] = {}
        self._learning: dict[tuple[int, int], Connection] = {}
        self._deliveries: list[Delivery] = []
        self._listener = Listener(learner.address, family="AF_UNIX", authkey=learner.key, backlog=256)
        self._arrivals, self._inbox = Pipe(duplex=False)
        self._connections: list[Connection] = [self._arrivals]
        self._new: deque[Connection] = deque()
        self._threads = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="files")
        self._done: deque[tuple[Connection, Callable[[], Any]]] = deque()
        threading.Thread(target=self._accept, daemon=True).start()
        self.account = dict.fromkeys(("asking for updates", "requests", "deliveries", "waiting"), 0.0)
        self.turned_at = time.monotonic()
        self.account |= {"stacked updates": 0.0, "updates of runs": 0.0}

    @property
    def runs(self) -> int:
        """Runs that are in the slots."""
        return len(self._seats)

    def serve(self, should_stop: Callable[[], bool], poll_seconds: float = 0.5) -> None:
        """Serve until `should_stop`, which is asked about every `poll_seconds`, s.

        Raises:
            MemoryError: there is too little for so many slots. Players stay connected, without a reply.
            torch.OutOfMemoryError: the same, on a GPU.
        """
        while not should_stop():
            self.turned_at = time.monotonic()
            with self._clock("waiting"):
                patience = 0.0 if self._learning else DELIVERY_SECONDS if self._deliveries else poll_seconds
                ready = wait(self._connections, timeout=patience)
            with self._clock("requests"):
                for connection in ready:
                    self._handle(connection)
            with self._clock("asking for updates"):
                self._update()
            with self._clock("deliveries"):
                self._deliver()

    @contextmanager
    def _clock(self, part: str) -> Iterator[None]:
        """Add the time that the block takes to the `account`."""
        started = time.perf_counter()
        yield
        self.account[part] += time.perf_counter() - started

    def _accept(self) -> None:
        while True:
            try:
                self._new.append(self._listener.accept())
            except Exception:  # a stranger without the key, or one that went away
                time.sleep(0.01)
                continue
            self._inbox.send(None)

    def _handle(self, connection: Any) -> None:
        if connection is self._arrivals:
            self._arrivals.recv()
            while self._new:
                self._connections.append(self._new.popleft())
            while self._done:
                asked, reply = self._done.popleft()
                if asked in self._seats:  # else who asked has gone
                    self._answer(asked, reply)
            return
        try:
            request, *arguments = connection.recv()
        except (EOFError, OSError):
            self._dismiss(connection)
            return
        own = getattr(self, f"_{request}_for", None)
        if own is None:
            self._answer(connection, lambda: getattr(self._seats[connection], request)(*arguments))
        else:
            self._answer(connection, lambda: own(connection, *arguments))

    def _answer(self, connection: Connection, make: Callable[[], Any]) -> None:
        """Send what `make` returns, or the error that it raises."""
        try:
            reply = make()
        except (MemoryError, torch.OutOfMemoryError):
            raise  # nothing of it is to be trusted, for none of the players
        except CohortFullError as error:
            self._send(connection, (False, error))
        except Exception:
            self._send(connection, (False, traceback.format_exc()))
        else:
            if reply is not _LATER:
                self._send(connection, (True, reply))

    def _aside(self, connection: Connection, work: Callable[[], Any], then: Callable[[Any], Any]) -> Any:
        """Have files written or read in a thread; `then` makes the reply of the result, in this thread."""

        def done(future: Future[Any]) -> None:
            self._done.append((connection, lambda: then(future.result())))
            self._inbox.send(None)

        self._threads.submit(work).add_done_callback(done)
        return _LATER

    def _send(self, connection: Connection, message: tuple[bool, Any]) -> None:
        try:
            connection.send(message)
        except OSError:
            self._dismiss(connection)

    def _dismiss(self, connection: Connection) -> None:
        if connection in self._connections:
            self._connections.remove(connection)
        seat = self._seats.pop(connection, None)
        if seat is not None:
            self._learning.pop((id(seat.stack), seat.slot), None)
            self._stacks.leave(seat)
        self._drop_mailbox(connection)
        connection.close()

    def _drop_mailbox(self, connection: Connection) -> None:
        mailbox = self._mailboxes.pop(connection, None)
        if mailbox is not None:
            mailbox.close()

    def _update(self) -> None:
        """Make some of the updates that are due, and start to copy the weights of runs without any left."""
        for stack in self._stacks.stacks:
            due = [slot for number, slot in self._learning if number == id(stack)]
            if not due:
                continue
            slots = due if stack.together else due[:1]  # the longest wait
            count = min(MOST_AT_ONCE, int(stack.owed[slots].min()))
            stack.advance(count, slots)
            self.account["stacked updates"] += count
            self.account["updates of runs"] += count * len(slots)
            finished = [slot for slot in slots if not stack.owed[slot]]
            if finished:
                receivers = [self._learning.pop((id(stack), slot)) for slot in finished]
                self._deliveries.append(Delivery.of(receivers, stack.actors(finished)))
            if self._stacks.settings.device.startswith("cuda"):
                self._work.append(recorded())
                if len(self._work) > UNDER_WAY:
                    self._work.popleft().synchronize()

    def _deliver(self) -> None:
        under_way, self._deliveries = self._deliveries, []
        for delivery in under_way:
            if delivery.arrival is not None and not delivery.arrival.query():  # type: ignore[no-untyped-call]
                self._deliveries.append(delivery)
                continue
            for connection, weights in zip(delivery.receivers, delivery.rows.numpy(), strict=True):
                mailbox = self._mailboxes.get(connection)
                (message,) = mailbox.post((weights,)) if mailbox else (weights,)
                self._send(connection, (True, message))

    def _join_for(self, connection: Connection, membership: JoinRequest) -> Any:
        self._seats[connection] = self._stacks.seat(membership)
        return self._seats[connection].weights()

    def _share_for(self, connection: Connection, size: int) -> Any:
        self._drop_mailbox(connection)
        self._mailboxes[connection] = SharedBuffer.receive(connection, size)

    def _learn_for(self, connection: Connection, experience: tuple[Any, ...], updates: int) -> Any:
        seat, mailbox = self._seats[connection], self._mailboxes.get(connection)
        seat.learn(mailbox.collect(experience) if mailbox else experience, updates)
        if not updates:
            return None
        self._learning[id(seat.stack), seat.slot] = connection
        return _LATER

    def _save_for(self, connection: Connection, folder: Path, state: WorkerState, incremental: bool) -> Any:
        write = self._seats[connection].save(folder, state, incremental)
        return self._aside(connection, write, lambda unchanged: unchanged)

    def _load_for(self, connection: Connection, folder: Path) -> Any:
        seat = self._seats[connection]
        return self._aside(connection, lambda: seat.student.load(folder), lambda _: seat.load_state())

    def _hardware_for(self, _: Connection) -> Any:
        settings = self._stacks.settings
        names = {"cohort": settings.width, "compiled": settings.compiled, "threads": settings.threads}
        capability = torch.backends.cpu.get_cpu_capability()
        entries = {"device": settings.device, "vector_extensions": capability, **names}
        if torch.device(settings.device).type == "cuda":
            entries["gpu"] = torch.cuda.get_device_name(settings.device)
        return entries

    def _account_for(self, _: Connection) -> Any:
        return dict(self.account)

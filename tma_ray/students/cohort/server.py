"""Server that receives experience from rollout workers, updates their networks and returns weights."""

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


def recorded_event() -> torch.cuda.Event:
    """Record an event on the current CUDA stream and return it; waiting for it blocks without spinning."""
    event = torch.cuda.Event(blocking=True)  # type: ignore[no-untyped-call]
    event.record()
    return event


class Delivery(NamedTuple):
    """Asynchronous copy of weights to the host, with one row for each receiver."""

    receivers: Sequence[Connection]
    rows: torch.Tensor
    arrival: torch.cuda.Event | None  # None if the copy is done

    @classmethod
    def of(cls, receivers: Sequence[Connection], rows: torch.Tensor) -> "Delivery":
        """Start copying `rows` (n, ...), one for each of n `receivers`, and return the delivery."""
        if rows.device.type != "cuda":
            return cls(receivers, rows.to("cpu"), None)
        memory = torch.empty(rows.shape, dtype=rows.dtype, pin_memory=True)
        memory.copy_(rows, non_blocking=True)
        return cls(receivers, memory, recorded_event())


FILE_THREADS = 2  # number of threads that read and write checkpoints
MOST_QUEUED = 2  # largest number of update batches queued on a GPU; more would delay requests
MOST_UPDATES = 8  # largest number of updates between two polls for requests
DELIVERY_SECONDS = 0.0005  # time between two polls for finished copies from a GPU, in s
_LATER = object()  # placeholder for a reply that is sent later


class LearnerServer:
    """Server for rollout workers, each with one connection and one request at a time.

    A worker gets its weights as soon as its updates are made, and frees its slot when it disconnects.

    Attributes:
        account: seconds spent on each part of the work, and numbers of updates.
        turned_at: start of the serving loop's last iteration on the monotonic clock, in s.
    """

    def __init__(self, learner: Learner, settings: CohortSettings) -> None:
        torch.set_num_threads(settings.threads)
        self._pool = LearnerPool(settings)
        self._work: deque[torch.cuda.Event] = deque()
        self._slots: dict[Connection, RunSlot] = {}
        self._buffers: dict[Connection, SharedBuffer] = {}
        self._learning: dict[tuple[int, int], Connection] = {}
        self._deliveries: list[Delivery] = []
        self._listener = Listener(learner.address, family="AF_UNIX", authkey=learner.key, backlog=256)
        self._arrivals, self._inbox = Pipe(duplex=False)
        self._connections: list[Connection] = [self._arrivals]
        self._new: deque[Connection] = deque()
        self._threads = ThreadPoolExecutor(FILE_THREADS, thread_name_prefix="files")
        self._done: deque[tuple[Connection, Callable[[], Any]]] = deque()
        threading.Thread(target=self._accept, daemon=True).start()
        self.account = dict.fromkeys(("asking for updates", "requests", "deliveries", "waiting"), 0.0)
        self.turned_at = time.monotonic()
        self.account |= {"stacked updates": 0.0, "updates of runs": 0.0}

    @property
    def runs(self) -> int:
        """Number of runs in the cohort."""
        return len(self._slots)

    def serve(self, should_stop: Callable[[], bool], poll_seconds: float = 0.5) -> None:
        """Serve requests until `should_stop`, polled at least every `poll_seconds`, returns True.

        Raises:
            MemoryError: if memory does not suffice for the slots. Workers stay connected, without a reply.
            torch.OutOfMemoryError: if a GPU's memory does not suffice.
        """
        while not should_stop():
            self.turned_at = time.monotonic()
            with self._clock("waiting"):
                timeout = 0.0 if self._learning else DELIVERY_SECONDS if self._deliveries else poll_seconds
                ready = wait(self._connections, timeout=timeout)
            with self._clock("requests"):
                for connection in ready:
                    self._handle(connection)
            with self._clock("asking for updates"):
                self._update()
            with self._clock("deliveries"):
                self._deliver()

    @contextmanager
    def _clock(self, part: str) -> Iterator[None]:
        """Context manager that adds the time spent inside it to `part` of the `account`."""
        started = time.perf_counter()
        yield
        self.account[part] += time.perf_counter() - started

    def _accept(self) -> None:
        while True:
            try:
                self._new.append(self._listener.accept())
            except Exception:  # wrong key or lost connection
                time.sleep(0.01)
                continue
            self._inbox.send(None)

    def _handle(self, connection: Any) -> None:
        if connection is self._arrivals:
            self._arrivals.recv()
            while self._new:
                self._connections.append(self._new.popleft())
            while self._done:
                worker, reply = self._done.popleft()
                if worker in self._slots:  # otherwise the worker has disconnected
                    self._answer(worker, reply)
            return
        try:
            request, *arguments = connection.recv()
        except (EOFError, OSError):
            self._dismiss(connection)
            return
        handler = getattr(self, f"_{request}_for", None)
        if handler is None:
            self._answer(connection, lambda: getattr(self._slots[connection], request)(*arguments))
        else:
            self._answer(connection, lambda: handler(connection, *arguments))

    def _answer(self, connection: Connection, make: Callable[[], Any]) -> None:
        """Reply with the result of `make`, or with the error that it raises."""
        try:
            reply = make()
        except (MemoryError, torch.OutOfMemoryError):
            raise  # an interrupted update may have left any run inconsistent
        except CohortFullError as error:
            self._send(connection, (False, error))
        except Exception:
            self._send(connection, (False, traceback.format_exc()))
        else:
            if reply is not _LATER:
                self._send(connection, (True, reply))

    def _run_in_thread(
        self, connection: Connection, work: Callable[[], Any], then: Callable[[Any], Any]
    ) -> Any:
        """Run `work` in another thread, then reply with `then(result)`, called in the server's thread."""

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
        run = self._slots.pop(connection, None)
        if run is not None:
            self._learning.pop((id(run.stack), run.slot), None)
            self._pool.leave(run)
        self._drop_buffer(connection)
        connection.close()

    def _drop_buffer(self, connection: Connection) -> None:
        buffer = self._buffers.pop(connection, None)
        if buffer is not None:
            buffer.close()

    def _update(self) -> None:
        """Perform a batch of pending updates, and start copying the weights of runs that have none left."""
        for stack in self._pool.stacks:
            due = [slot for number, slot in self._learning if number == id(stack)]
            if not due:
                continue
            slots = due if stack.together else due[:1]  # one at a time: the run that has waited longest
            count = min(MOST_UPDATES, int(stack.owed[slots].min()))
            stack.advance(count, slots)
            self.account["stacked updates"] += count
            self.account["updates of runs"] += count * len(slots)
            finished = [slot for slot in slots if not stack.owed[slot]]
            if finished:
                receivers = [self._learning.pop((id(stack), slot)) for slot in finished]
                self._deliveries.append(Delivery.of(receivers, stack.actors(finished)))
            if self._pool.settings.device.startswith("cuda"):
                self._work.append(recorded_event())
                if len(self._work) > MOST_QUEUED:
                    self._work.popleft().synchronize()

    def _deliver(self) -> None:
        deliveries, self._deliveries = self._deliveries, []
        for delivery in deliveries:
            if delivery.arrival is not None and not delivery.arrival.query():  # type: ignore[no-untyped-call]
                self._deliveries.append(delivery)
                continue
            for connection, weights in zip(delivery.receivers, delivery.rows.numpy(), strict=True):
                buffer = self._buffers.get(connection)
                (message,) = buffer.post((weights,)) if buffer else (weights,)
                self._send(connection, (True, message))

    def _join_for(self, connection: Connection, request: JoinRequest) -> Any:
        self._slots[connection] = self._pool.join(request)
        return self._slots[connection].weights()

    def _share_for(self, connection: Connection, size: int) -> Any:
        self._drop_buffer(connection)
        self._buffers[connection] = SharedBuffer.receive(connection, size)

    def _learn_for(self, connection: Connection, experience: tuple[Any, ...], updates: int) -> Any:
        run, buffer = self._slots[connection], self._buffers.get(connection)
        run.learn(buffer.collect(experience) if buffer else experience, updates)
        if not updates:
            return None
        self._learning[id(run.stack), run.slot] = connection
        return _LATER

    def _save_for(self, connection: Connection, folder: Path, state: WorkerState, incremental: bool) -> Any:
        write = self._slots[connection].save(folder, state, incremental)
        return self._run_in_thread(connection, write, lambda unchanged: unchanged)

    def _load_for(self, connection: Connection, folder: Path) -> Any:
        run = self._slots[connection]
        return self._run_in_thread(connection, lambda: run.student.load(folder), lambda _: run.load_state())

    def _hardware_for(self, _: Connection) -> Any:
        settings = self._pool.settings
        names = {"cohort": settings.width, "compiled": settings.compiled, "threads": settings.threads}
        capability = torch.backends.cpu.get_cpu_capability()
        entries = {"device": settings.device, "vector_extensions": capability, **names}
        if torch.device(settings.device).type == "cuda":
            entries["gpu"] = torch.cuda.get_device_name(settings.device)
        return entries

    def _account_for(self, _: Connection) -> Any:
        return dict(self.account)

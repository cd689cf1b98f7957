"""Ray actors that host runs, their teachers, and the learners of cohorts."""

from __future__ import annotations

import platform
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

import psutil
import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy, NodeLabelSchedulingStrategy, NotIn

from tma_ray.campaign.cluster.connection import use_shipped
from tma_ray.campaign.cluster.ray_private import sockets_folder
from tma_ray.campaign.settings import GIB, Resources, TeacherPlacement
from tma_ray.results import LearnerProgress, PartFile, Store
from tma_ray.runs.attempt import Attempt, Report
from tma_ray.runs.inputs import contents, provide
from tma_ray.runs.placement import Placement
from tma_ray.runs.spec import RunSpec
from tma_ray.runs.teaching import InlineTeacher
from tma_ray.students import Learner
from tma_ray.students.rollout_workers import CohortSettings
from tma_ray.support.import_hacks import skip_pandas

NODE_LABEL = "ray.io/node-id"  # label with a node's id, set by Ray


def node_strategy(node: str, avoid: Sequence[str] = ()) -> Any:
    """Return Ray's scheduling strategy for `node` ("" for any node, preferably not in `avoid`)."""
    if node:
        return NodeAffinitySchedulingStrategy(node, soft=False)
    others: Any = NotIn
    return NodeLabelSchedulingStrategy({}, soft={NODE_LABEL: others(*avoid)}) if avoid else "DEFAULT"


def launcher(kind: type, resources: Resources, strategy: Any, concurrent_calls: int) -> Any:
    """Return `kind` as a Ray actor class with the given resources; Ray never restarts its actors."""
    remote: Any = ray.remote(kind)
    return remote.options(
        num_cpus=resources.cpus,
        num_gpus=resources.gpus,
        memory=int(resources.memory_gib * GIB),
        max_restarts=0,
        max_concurrency=concurrent_calls,
        scheduling_strategy=strategy,
    )


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

SEED_CALLS = 4
"""Concurrent calls to a seed actor: `run`, a repeated call that waits for it, a report, a stop request."""


class TeacherActor(InlineTeacher):
    """Ray actor that hosts a teacher; it imports torch only for teachers that use it.

    `start` constructs the teacher: an actor whose constructor raises counts as dead, and its run as lost.
    """

    def __init__(self) -> None:
        """Create the actor without a teacher, which `start` constructs."""

    def start(self, spec: dict[str, Any], inputs: Mapping[str, bytes]) -> None:
        """Construct and start a run's teacher.

        Raises:
            Exception: if the teacher raises it.
        """
        use_shipped()
        provide(inputs)
        InlineTeacher.__init__(self, RunSpec.from_dict(spec))


def _remote(
    method: Callable[Concatenate[InlineTeacher, Arguments], Result],
) -> Callable[Concatenate[RemoteTeacher, Arguments], Result]:
    """Return a method for `RemoteTeacher` that calls `method` in the teacher's actor."""

    def call(self: RemoteTeacher, /, *arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
        if self.starting is not None:
            ray.get(self.starting)
            self.starting = None
        return cast("Result", ray.get(getattr(self.actor, method.__name__).remote(*arguments, **options)))

    call.__doc__ = method.__doc__
    return call


class RemoteTeacher:
    """Link to a teacher in an actor on this node; the actor ends with this process. See `TeacherLink`."""

    def __init__(self, spec: RunSpec) -> None:
        this_node = node_strategy(ray.get_runtime_context().get_node_id())
        remote: Any = ray.remote(TeacherActor)
        options = {"num_cpus": 0, "max_restarts": 0, "scheduling_strategy": this_node}
        self.actor = remote.options(**options).remote()
        self.starting: Any = self.actor.start.remote(spec.to_dict(), contents([spec]))

    exchange = _remote(InlineTeacher.exchange)
    answer = _remote(InlineTeacher.answer)
    probe = _remote(InlineTeacher.probe)
    save = _remote(InlineTeacher.save)
    load = _remote(InlineTeacher.load)


class SeedActor:
    """Ray actor that executes one attempt at a run; `report` and `request_stop` may be called during `run`.

    Created by `launch`. Ray does not restart it, since a new attempt needs a new number from the scheduler.
    """

    def __init__(
        self,
        spec: dict[str, Any],
        store: Store,
        number: int,
        placement: Placement,
        teachers: TeacherPlacement,
    ) -> None:
        teacher = InlineTeacher if teachers is TeacherPlacement.INLINE else RemoteTeacher
        self._attempt = Attempt(RunSpec.from_dict(spec), store, number, placement, teacher)
        self._placement = placement
        self._stop = threading.Event()
        self._outcome: Future[tuple[PartFile, ...] | None] | None = None
        self._first_call = threading.Lock()

    @classmethod
    def launch(cls, resources: Resources, strategy: Any, *arguments: Any) -> Any:
        """Create a seed actor, placed by a strategy from `node_strategy`, and return its handle."""
        return launcher(cls, resources, strategy, SEED_CALLS).remote(*arguments)

    def run(self) -> tuple[PartFile, ...] | None:
        """Execute the attempt, and return the canonical result files, or None after a stop.

        A repeated call, as after a network failure, waits for the first and returns its result.

        Raises:
            Exception: if teacher, student or environment raises it.
        """
        with self._first_call:
            outcome, self._outcome = self._outcome, self._outcome or Future()
        if outcome is not None:
            return outcome.result()
        assert self._outcome is not None
        try:
            skip_pandas()
            self._placement.give_way()
            use_shipped()
            self._outcome.set_result(self._attempt.execute(self._stop.is_set))
        except Exception as error:
            self._outcome.set_exception(error)
        return self._outcome.result()

    def report(self) -> Report | None:
        """Return the progress of the attempt, or None during its setup."""
        report = self._attempt.report()
        return report and replace(report, node=ray.get_runtime_context().get_node_id())

    def request_stop(self) -> None:
        """Request a checkpoint and the end of `run` after the current episode."""
        self._stop.set()


def reason_for_loss(error: Exception) -> str:
    """Return the cause of `error` in one line, without Ray's details."""
    lines = str(getattr(error, "cause", None) or error).splitlines()
    return " ".join(line for line in lines if not line.startswith("\t"))


LEARNER_CALLS = 6
"""Concurrent calls to a learner actor: `open` and `serve`, both repeatable, and a report."""

WINDOW_SECONDS = 30.0  # time over which speed and utilisation are averaged, s


LONGEST_TURN = 3600.0
"""Time without a new update after which a learner counts as stuck, s; compiling the first takes minutes."""

TURN_POLL = 5.0  # interval between checks for a stuck learner, s


class LearnerActor:
    """Ray actor that hosts a cohort's learner, created by `launch` and killed by the driver."""

    def __init__(self, settings: CohortSettings) -> None:
        self._settings = settings
        socket = sockets_folder() / f"learner-{secrets.token_hex(4)}"
        self._learner = Learner(str(socket), secrets.token_bytes(32))
        self._server: Any = None
        self._failure: Exception | None = None
        self._listens = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._samples: deque[tuple[float, float, float]] = deque()
        self._thread.start()

    @classmethod
    def launch(cls, settings: CohortSettings, resources: Resources, node: str) -> Any:
        """Create a learner on the node with Ray id `node` (or, for "", any node), and return its handle."""
        return launcher(cls, resources, node_strategy(node), LEARNER_CALLS).remote(settings)

    def open(self) -> tuple[Learner, str]:
        """Wait until rollout workers can connect, and return the learner's address and its node's Ray id.

        Raises:
            MemoryError: if the device has too little memory.
            Exception: if torch raises it.
        """
        while not self._listens.wait(0.1) and self._thread.is_alive():
            pass
        if self._failure is not None:
            raise self._failure
        return self._learner, ray.get_runtime_context().get_node_id()

    def serve(self) -> None:
        """Block until the learner fails; several callers may wait at once.

        Raises:
            MemoryError: if the device has too little memory. Rollout workers stay connected until this
                process ends.
            TimeoutError: if the learner is stuck.
            Exception: if anything else ended the learner.
        """
        wait_for_end(self._thread, lambda: self._server and self._server.turned_at)
        if self._failure is not None:
            raise self._failure

    def report(self) -> LearnerProgress | None:
        """Return the progress of the learner, or None while it does not yet accept connections."""
        if self._server is None:
            return None
        account, now = dict(self._server.account), time.monotonic()
        self._samples.append((now, account["updates of runs"], account["waiting"]))
        while len(self._samples) > 2 and self._samples[1][0] < now - WINDOW_SECONDS:
            self._samples.popleft()
        start, updates, waiting = self._samples[0]
        seconds = now - start
        if self._settings.device == "cpu":
            used, total = psutil.Process().memory_info().rss, psutil.virtual_memory().total
        else:
            import torch

            free, total = torch.cuda.mem_get_info()
            used = total - free
        return LearnerProgress(
            host=platform.node(),
            device=self._settings.device,
            width=self._settings.width,
            runs=self._server.runs,
            updates_per_second=(account["updates of runs"] - updates) / seconds if seconds else 0.0,
            busy=1 - min(1.0, (account["waiting"] - waiting) / seconds) if seconds else 0.0,
            memory_gib=used / GIB,
            memory_total_gib=total / GIB,
        )

    def _work(self) -> None:
        try:
            # imported late: torch takes seconds, and a failed import must not kill the actor
            from tma_ray.students.cohort.server import LearnerServer

            self._server = LearnerServer(self._learner, self._settings)
            self._listens.set()
            self._server.serve(lambda: False)
        except Exception as error:
            from torch import OutOfMemoryError  # converted, since the driver cannot unpickle it without torch

            out_of_memory = isinstance(error, (MemoryError, OutOfMemoryError))
            self._failure = MemoryError(str(error).partition("\n")[0]) if out_of_memory else error


def wait_for_end(thread: threading.Thread, turned_at: Callable[[], float | None]) -> None:
    """Wait until a learner's thread ends, or raise an error if its updates have stopped.

    `turned_at` returns the time (`time.monotonic`) of the last update, or None before the first.

    Raises:
        TimeoutError: if an update takes longer than `LONGEST_TURN`.
    """
    while thread.is_alive():
        thread.join(TURN_POLL)
        last = turned_at()
        if last is not None and time.monotonic() - last > LONGEST_TURN:
            raise TimeoutError(
                f"it has been at the same updates for {LONGEST_TURN / 60:.0f} minutes: its device hangs"
            )

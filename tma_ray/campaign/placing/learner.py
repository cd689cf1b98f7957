"""The learner of a cohort as a Ray actor, which players on its node reach over a socket."""

from __future__ import annotations

import platform
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import psutil
import ray

from tma_ray.campaign.placing.launching import launcher, node_strategy
from tma_ray.campaign.settings import GIB, Resources
from tma_ray.results import LearnerProgress
from tma_ray.students import Learner
from tma_ray.students.players import CohortSettings

CONCURRENT_CALLS = 6
"""Of a learner actor at once: two that wait, also again after it was out of sight, and a report."""

WINDOW_SECONDS = 30.0
"""Time over which speed and share of work are averaged, s."""


LONGEST_TURN = 3600.0
"""Time after which a learner counts as stuck that is still at the same few updates, s: its GPU may hang. The
compilation of a first update takes minutes."""

TURN_POLL = 5.0
"""Time between two looks at whether a learner is stuck, s."""


class Opened(NamedTuple):
    """A learner that listens.

    Attributes:
        learner: its address on its node.
        node: Ray's id of that.
    """

    learner: Learner
    node: str


class LearnerActor:
    """The learner of a cohort in a process of its own. The driver makes it with `launch`, and kills it.

    Args:
        settings: of the cohort.
    """

    def __init__(self, settings: CohortSettings) -> None:
        self._settings = settings
        node: Any = ray._private.worker.global_worker.node  # whose folder for sockets has a short path
        socket = Path(node.get_sockets_dir_path(), f"learner-{secrets.token_hex(4)}")
        self._learner = Learner(str(socket), secrets.token_bytes(32))
        self._server: Any = None
        self._failure: Exception | None = None
        self._listens = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._samples: deque[tuple[float, float, float]] = deque()
        self._thread.start()

    @classmethod
    def launch(cls, settings: CohortSettings, resources: Resources, node: str) -> Any:
        """Returns the handle of a new learner on a node, by Ray's id; without one, Ray chooses."""
        return launcher(cls, resources, node_strategy(node), CONCURRENT_CALLS).remote(settings)

    def open(self) -> Opened:
        """Returns when players can connect.

        Raises:
            MemoryError: the device has too little memory.
            Exception: whatever else torch raises.
        """
        while not self._listens.wait(0.1) and self._thread.is_alive():
            pass
        if self._failure is not None:
            raise self._failure
        return Opened(self._learner, ray.get_runtime_context().get_node_id())

    def serve(self) -> None:
        """Waits for the end, which comes with a failure only; any number of calls may wait.

        Raises:
            MemoryError: the device has too little memory. Players stay connected: they do not learn of it
                before this process is killed.
            TimeoutError: the work does not go on, and nothing ends it.
            Exception: whatever else ended the work.
        """
        wait_for_end(self._thread, lambda: self._server and self._server.turned_at)
        if self._failure is not None:
            raise self._failure

    def report(self) -> LearnerProgress | None:
        """Returns how the learner is; None before it listens."""
        if self._server is None:
            return None
        updates, busy = self._rates()
        used, total = self._memory()
        return LearnerProgress(
            host=platform.node(),
            device=self._settings.device,
            width=self._settings.width,
            runs=self._server.runs,
            updates_per_second=updates,
            busy=busy,
            memory_gib=used,
            memory_total_gib=total,
        )

    def _work(self) -> None:
        try:
            # Imported here: torch takes seconds, and its failure is to be told apart from a lost process.
            from tma_ray.students.cohort.server import LearnerServer

            self._server = LearnerServer(self._learner, self._settings)
            self._listens.set()
            self._server.serve(lambda: False)
        except Exception as error:
            from torch import OutOfMemoryError  # torch is not in the driver, which takes this for what it is

            short = isinstance(error, (MemoryError, OutOfMemoryError))
            self._failure = MemoryError(str(error).partition("\n")[0]) if short else error

    def _rates(self) -> tuple[float, float]:
        """Returns updates of runs per second, and the share of time in which there was work."""
        account, now = dict(self._server.account), time.monotonic()
        self._samples.append((now, account["updates of runs"], account["waiting"]))
        while len(self._samples) > 2 and self._samples[1][0] < now - WINDOW_SECONDS:
            self._samples.popleft()
        before, updates, waiting = self._samples[0]
        seconds = now - before
        if not seconds:
            return 0.0, 0.0
        idle = min(1.0, (account["waiting"] - waiting) / seconds)
        return (account["updates of runs"] - updates) / seconds, 1 - idle

    def _memory(self) -> tuple[float, float]:
        """Returns memory in use and all that there is, GiB: the GPU's, or this process's of the machine's."""
        if self._settings.device == "cpu":
            return psutil.Process().memory_info().rss / GIB, psutil.virtual_memory().total / GIB
        import torch

        free, total = torch.cuda.mem_get_info()
        return (total - free) / GIB, total / GIB


def wait_for_end(thread: threading.Thread, turned_at: Callable[[], float | None]) -> None:
    """Waits for the end of a learner's thread.

    Args:
        thread: in which it works.
        turned_at: time of its last look at what players ask, on the monotonic clock, s; None before the
            first.

    Raises:
        TimeoutError: it has been at the same updates for longer than `LONGEST_TURN`.
    """
    while thread.is_alive():
        thread.join(TURN_POLL)
        last = turned_at()
        if last is not None and time.monotonic() - last > LONGEST_TURN:
            raise TimeoutError(
                f"it has been at the same updates for {LONGEST_TURN / 60:.0f} minutes: its device hangs"
            )

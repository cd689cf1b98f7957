"""Handling of failures: retries of lost runs and failed writes, silent runs, and stop signals."""

import logging
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Concatenate, ParamSpec, TypeVar

from tma_ray.results import Committer, StorageError, growing_pause, retry
from tma_ray.runs.spec import RunSpec


class HeadLostError(RuntimeError):
    """Error raised if Ray's head dies, is stopped, or is silent for too long."""


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class OutageError(RuntimeError):
    """Error raised if the storage of results fails for longer than the settings allow."""


class RetryingCommitter:
    """Wrapper around a `Committer` that retries calls when the storage fails.

    It checks the lease on the root before every call: during a long outage another campaign may have
    acquired it.
    """

    def __init__(self, committer: Committer, keep_lease: Callable[[], None], seconds: float) -> None:
        self._committer = committer
        self._keep_lease = keep_lease
        self._seconds = seconds

    def keep_lease(self) -> None:
        """Renew the lease, with the same retries and errors as `call`."""
        self._retry(self._keep_lease)

    def call(
        self,
        operation: Callable[Concatenate[Committer, Arguments], Result],
        *arguments: Arguments.args,
        **options: Arguments.kwargs,
    ) -> Result:
        """Call a method of the committer, as in ``call(Committer.manifest, run_id)``; return its result.

        Raises:
            RootInUseError: if another campaign holds the lease on the root.
            OutageError: if the storage refuses every attempt.
        """

        def attempt() -> Result:
            self._keep_lease()
            return operation(self._committer, *arguments, **options)

        return self._retry(attempt)

    def _retry(self, action: Callable[[], Result]) -> Result:
        try:
            return retry(action, self._seconds)
        except StorageError as error:
            raise OutageError(f"the campaign ends after {self._seconds:.0f} s of retries: {error}") from error


LONGEST_LOSS_PAUSE = 300.0  # longest pause before another attempt at a lost run, s


class Retries:
    """Queue of lost runs that wait for another attempt.

    Each loss of a run doubles the pause before its next attempt, so that a persistent cause (too little
    memory, a broken mount) does not occupy the cluster.
    """

    def __init__(self, most_losses: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._most_losses = most_losses
        self._clock = clock
        self._lost_on: dict[str, list[str]] = {}
        """Nodes on which each run was lost, by run id; "" if unknown."""
        self._pausing: list[tuple[float, RunSpec]] = []

    def __len__(self) -> int:
        return len(self._pausing)

    @property
    def specs(self) -> list[RunSpec]:
        """Specs of the waiting runs."""
        return [spec for _, spec in self._pausing]

    def add_loss(self, spec: RunSpec, node: str) -> bool:
        """Schedule a retry of a run lost on `node` ("" if unknown); return False after too many losses."""
        self._lost_on.setdefault(spec.run_id, []).append(node)
        losses = self.losses(spec.run_id)
        if losses > self._most_losses:
            return False
        self._pausing.append((self._clock() + growing_pause(losses, LONGEST_LOSS_PAUSE), spec))
        return True

    def due(self) -> list[RunSpec]:
        """Remove and return the specs of the runs whose pause has ended."""
        now = self._clock()
        due = [spec for end, spec in self._pausing if end <= now]
        self._pausing = [(end, spec) for end, spec in self._pausing if end > now]
        return due

    def losses(self, run_id: str) -> int:
        """Return how many times a run has been lost."""
        return len(self._lost_on.get(run_id, ()))

    def nodes_to_avoid(self, run_id: str) -> tuple[str, ...]:
        """Return the nodes on which a run was lost."""
        return tuple(dict.fromkeys(node for node in self._lost_on.get(run_id, ()) if node))


LOG_SECONDS = 60.0  # minimum time between repeated log messages, s
MOST_NAMED_RUNS = 3  # largest number of runs that a message names

logger = logging.getLogger(__name__)


class SilentRuns:
    """Tracker of runs that do not answer, which count as lost after `most_seconds`."""

    def __init__(self, most_seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._most_seconds = most_seconds
        self._clock = clock
        self._since: dict[str, float] = {}
        self._logged = -math.inf

    def has_expired(self, run_id: str) -> bool:
        """Record that a run did not answer, and return True if it has been silent for too long.

        All silent runs are logged once a minute.
        """
        now = self._clock()
        since = self._since.setdefault(run_id, now)
        if now - self._logged >= LOG_SECONDS:
            self._logged = now
            names = sorted(self._since)
            more = f" and {len(names) - MOST_NAMED_RUNS} more" if len(names) > MOST_NAMED_RUNS else ""
            verb = "do not answer and are" if len(names) > 1 else "does not answer and is"
            logger.warning(
                "%s%s %s not known to be dead; after %.0f s of silence a run counts as lost",
                ", ".join(names[:MOST_NAMED_RUNS]),
                more,
                verb,
                self._most_seconds,
            )
        return now - since > self._most_seconds

    def end(self, run_id: str) -> None:
        """Stop tracking a run, which has answered or is lost."""
        self._since.pop(run_id, None)


@contextmanager
def stop_signals() -> Iterator[threading.Event]:
    """Context manager that yields an event set by SIGINT or SIGTERM; a second one raises KeyboardInterrupt.

    Enter it after `ray.init`, which installs its own handlers. It does nothing outside the main thread, where
    Python cannot handle signals.
    """
    requested = threading.Event()

    def handle(number: int, _frame: FrameType | None) -> None:
        if requested.is_set():
            raise KeyboardInterrupt(f"second signal {signal.Signals(number).name}")
        requested.set()

    in_main_thread = threading.current_thread() is threading.main_thread()
    handled = (signal.SIGINT, signal.SIGTERM) if in_main_thread else ()
    before = {number: signal.signal(number, handle) for number in handled}
    try:
        yield requested
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

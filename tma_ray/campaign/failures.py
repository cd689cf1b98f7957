"""Answers to failures: retries of lost runs and refused writes, silent runs, requests to stop."""

import logging
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Concatenate, ParamSpec, TypeVar

from tma_ray.results import Committer, StorageError, retry
from tma_ray.runs.spec import RunSpec


class HeadLostError(RuntimeError):
    """Ray's head has died, was stopped, or did not answer for as long as Ray waits for it."""


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class OutageError(RuntimeError):
    """The storage of a campaign's results failed for longer than its settings allow."""


class RetryingCommitter:
    """Caller of the methods of a `Committer` that retries those that the storage refuses.

    Before every attempt it checks that the lease on the root is still held: a storage that was unavailable
    for long may have been given to another campaign meanwhile.
    """

    def __init__(self, committer: Committer, keep_lease: Callable[[], None], seconds: float) -> None:
        self._committer = committer
        self._keep_lease = keep_lease
        self._seconds = seconds

    def keep_lease(self) -> None:
        """Renew the lease, with the retries and errors of `call`."""
        self._retry(self._keep_lease)

    def call(
        self,
        operation: Callable[Concatenate[Committer, Arguments], Result],
        *arguments: Arguments.args,
        **options: Arguments.kwargs,
    ) -> Result:
        """Return the result of an operation of the committer, as in ``call(Committer.manifest, run_id)``.

        Raises:
            RootInUseError: another campaign holds the lease on the root.
            OutageError: the storage refused every attempt.
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


FIRST_PAUSE, LONGEST_PAUSE = 1.0, 300.0
"""Pause after a run's first loss, doubled with every other, and its bound, s."""


class Retries:
    """Runs that wait for another attempt after a loss.

    Each loss of a run doubles the pause before its next attempt, so that what kills every attempt (too little
    memory, a broken mount) does not occupy the cluster.
    """

    def __init__(self, most_losses: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._most_losses = most_losses
        self._clock = clock
        self._lost_on: dict[str, list[str]] = {}
        """Node of each loss of a run, empty where it is unknown."""
        self._pausing: list[tuple[float, RunSpec]] = []

    def __len__(self) -> int:
        return len(self._pausing)

    @property
    def specs(self) -> list[RunSpec]:
        """Runs that wait."""
        return [spec for _, spec in self._pausing]

    def add_loss(self, spec: RunSpec, node: str) -> bool:
        """Add a run that was lost on `node`, empty if unknown; return False if it is given up."""
        self._lost_on.setdefault(spec.run_id, []).append(node)
        losses = self.losses(spec.run_id)
        if losses > self._most_losses:
            return False
        pause = min(FIRST_PAUSE * 2 ** (losses - 1), LONGEST_PAUSE)
        self._pausing.append((self._clock() + pause, spec))
        return True

    def due(self) -> list[RunSpec]:
        """Return the runs whose pause is over; they wait here no longer."""
        now = self._clock()
        due = [spec for at, spec in self._pausing if at <= now]
        self._pausing = [(at, spec) for at, spec in self._pausing if at > now]
        return due

    def losses(self, run_id: str) -> int:
        """Return the number of losses of a run."""
        return len(self._lost_on.get(run_id, ()))

    def nodes_to_avoid(self, run_id: str) -> tuple[str, ...]:
        """Return the nodes on which a run was lost."""
        return tuple(dict.fromkeys(node for node in self._lost_on.get(run_id, ()) if node))


LOG_SECONDS = 60.0  # time between two messages, s
MOST_NAMES = 3  # largest number of runs that a message names; the others are counted

logger = logging.getLogger(__name__)


class Silence:
    """Record of runs that do not answer, which are given up after `most_seconds`."""

    def __init__(self, most_seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._most_seconds = most_seconds
        self._clock = clock
        self._since: dict[str, float] = {}
        self._logged = -math.inf

    def lasts(self, run_id: str) -> bool:
        """Note that a run did not answer; return True if it has been silent for too long.

        All runs that are silent at the moment are logged, once a minute.
        """
        now = self._clock()
        since = self._since.setdefault(run_id, now)
        if now - self._logged >= LOG_SECONDS:
            self._logged = now
            names = sorted(self._since)
            more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
            verb = "do not answer and are" if len(names) > 1 else "does not answer and is"
            logger.warning(
                "%s%s %s not known to be dead; after %.0f s of silence a run counts as lost",
                ", ".join(names[:MOST_NAMES]),
                more,
                verb,
                self._most_seconds,
            )
        return now - since > self._most_seconds

    def end(self, run_id: str) -> None:
        """Note that a run answers, or is lost."""
        self._since.pop(run_id, None)


@contextmanager
def stop_signals() -> Iterator[threading.Event]:
    """Context manager of an event that a first SIGINT or SIGTERM sets; a second raises KeyboardInterrupt.

    Enter it after `ray.init`, which installs handlers of its own. Outside of the main thread, where
    Python cannot handle signals, it changes nothing.
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

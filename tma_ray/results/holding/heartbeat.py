"""The heartbeat of a running campaign, for those who only see its results root."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Final, Self

from tma_ray.decoding import DamagedFileError, Natural, Seconds, decode_json
from tma_ray.results.holding.process import Process
from tma_ray.results.layout import HEARTBEAT_FILE
from tma_ray.results.storage.errors import StorageError
from tma_ray.results.storage.store import Store

HEARTBEAT_SECONDS: Final = 15.0
"""Time between two heartbeats, s."""

SILENT_SECONDS: Final = 120.0
"""Silence after which a campaign is taken to be dead, s."""


@dataclass(frozen=True)
class RunProgress:
    """Progress of a running run, newer than its published one.

    Attributes:
        step: environment steps.
        steps_per_second: environment steps per second.
    """

    step: Natural
    steps_per_second: float


@dataclass(frozen=True)
class LearnerProgress:
    """Progress of the learner of a cohort.

    Attributes:
        host: name of its machine.
        device: torch's name of where it learns.
        width: its slots.
        runs: that are in them.
        updates_per_second: updates of single runs, of late.
        busy: share of the time in which it had work, of late.
        memory_gib: in use, of the GPU, or by its process on a CPU, GiB.
        memory_total_gib: that there is, GiB.
    """

    host: str
    device: str
    width: Natural
    runs: Natural
    updates_per_second: float
    busy: float
    memory_gib: float
    memory_total_gib: float


@dataclass(frozen=True)
class Heartbeat:
    """A sign of life.

    Attributes:
        holder: campaign, host and process, as in the lease.
        at: when it was given, s since 1970.
        runs: the running runs by id.
        ended: whether it was the last, of a campaign that has left.
        process: that gave it, None where others could not find it.
        learners: of cohorts, if runs learn in any.
    """

    holder: str
    at: Seconds
    runs: Mapping[str, RunProgress] = field(default_factory=dict)
    ended: bool = False
    process: Process | None = None
    learners: tuple[LearnerProgress, ...] = ()

    @classmethod
    def load(cls, store: Store) -> Self | None:
        """Returns the last heartbeat on a root; None if there is none, or none that can be read."""
        try:
            return decode_json(store.read_bytes(HEARTBEAT_FILE), cls, store.where(HEARTBEAT_FILE))
        except (FileNotFoundError, DamagedFileError):
            return None  # of no consequence: it only tells more than the manifests do

    def alive(self, now: float) -> bool:
        """Tells whether its campaign is running, as far as one can know at `now`.

        A sign from the future is none: the clock of who gave it is wrong.
        """
        if self.ended or (self.process is not None and self.process.is_dead()):
            return False
        return abs(now - self.at) < SILENT_SECONDS

    def write(self, store: Store) -> None:
        """Replaces the root's heartbeat by this one."""
        store.write_bytes(HEARTBEAT_FILE, json.dumps(asdict(self)).encode())


class HeartbeatWriter:
    """Writes a campaign's heartbeats, not more often than every `HEARTBEAT_SECONDS`.

    Args:
        store: the results root.
        holder: campaign, host and process.
        clock: current time, s since 1970.
    """

    def __init__(self, store: Store, holder: str, clock: Callable[[], float] = time.time) -> None:
        self._store = store
        self._holder = holder
        self._clock = clock
        self._last = 0.0

    def beat(self, runs: Mapping[str, RunProgress], learners: Sequence[LearnerProgress] = ()) -> None:
        """Says which runs are running, and how their learners are, if it is time."""
        if self._clock() - self._last >= HEARTBEAT_SECONDS:
            self._last = self._clock()
            with suppress(StorageError):  # it is for those who watch: the next one will do
                process, theirs = Process.this(), tuple(learners)
                Heartbeat(self._holder, self._last, runs, False, process, theirs).write(self._store)

    def end(self) -> None:
        """Says that the campaign has left, unless another one has taken the root over."""
        with suppress(StorageError):
            newest = Heartbeat.load(self._store)
            if newest is not None and newest.holder == self._holder:
                Heartbeat(self._holder, self._clock(), ended=True).write(self._store)

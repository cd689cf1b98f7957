"""Exclusive lease on a results root, and the heartbeat of the campaign that holds it."""

import json
import logging
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Final, NoReturn, Self
from uuid import uuid4

from tma_ray.console.exit_codes import RefusedError
from tma_ray.results.layout import HEARTBEAT_FILE, LEASE_FILE, STOP_FILE
from tma_ray.results.storage import StorageError, Store
from tma_ray.results.storage.base import Version
from tma_ray.support.decoding import DamagedFileError, Natural, Seconds, SmallNatural, decode_json
from tma_ray.support.validation import check_type


@dataclass(frozen=True)
class Process:
    """Identity of a process: boot id of the machine, PID namespace and PID."""

    boot: str
    namespace: str
    pid: SmallNatural

    @classmethod
    def this(cls) -> "Process | None":
        """Return the identity of this process, or None on systems without /proc."""
        try:
            boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
            namespace = str(Path("/proc/self/ns/pid").readlink())
        except OSError:
            return None
        return cls(boot, namespace, os.getpid())

    def is_dead(self) -> bool:
        """Return True if the process ran on this machine and has ended."""
        this = Process.this()
        if this is None or (self.boot, self.namespace) != (this.boot, this.namespace):
            return False
        return not Path(f"/proc/{self.pid}").exists()


HEARTBEAT_SECONDS: Final = 15.0  # minimum interval between heartbeats, s
SILENT_SECONDS: Final = 120.0  # time without heartbeats after which a campaign counts as dead, s


@dataclass(frozen=True)
class RunProgress:
    """Unpublished progress of a run: environment steps, and environment steps per second."""

    step: Natural
    steps_per_second: float


@dataclass(frozen=True)
class LearnerProgress:
    """Recent progress of the learner of a cohort.

    Attributes:
        device: torch device.
        width: number of slots.
        runs: number of runs in the slots.
        updates_per_second: updates summed over the runs, 1/s.
        busy: share of the time with work, in [0, 1].
        memory_gib: memory in use on the GPU, or by the process on a CPU, GiB.
        memory_total_gib: memory of the device, GiB.
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
    """Sign of life of a campaign, with the progress of its runs and learners.

    Attributes:
        holder: campaign, host and process, as in the lease.
        at: time of writing, s since 1970.
        runs: progress of running runs by id.
        ended: True for the last heartbeat of a campaign.
        process: process of the campaign, None if unknown.
        learners: progress of learners of cohorts.
    """

    holder: str
    at: Seconds
    runs: Mapping[str, RunProgress] = field(default_factory=dict)
    ended: bool = False
    process: Process | None = None
    learners: tuple[LearnerProgress, ...] = ()

    @classmethod
    def load(cls, store: Store) -> Self | None:
        """Return the last heartbeat of a root, or None if it is missing or damaged."""
        try:
            return store.read_json(HEARTBEAT_FILE, cls)
        except (FileNotFoundError, DamagedFileError):
            return None

    def alive(self, now: float) -> bool:
        """Return True if the campaign seems alive at the Unix time `now`; False if its clock is far off."""
        if self.ended or (self.process is not None and self.process.is_dead()):
            return False
        return abs(now - self.at) < SILENT_SECONDS

    def write(self, store: Store) -> None:
        """Write this heartbeat to a root."""
        store.write_json(HEARTBEAT_FILE, self)


class HeartbeatWriter:
    """Writer of a campaign's heartbeats, at most one every `HEARTBEAT_SECONDS`."""

    def __init__(self, store: Store, holder: str, clock: Callable[[], float] = time.time) -> None:
        self._store = store
        self._holder = holder
        self._clock = clock
        self._last = 0.0

    def beat(self, runs: Mapping[str, RunProgress], learners: Sequence[LearnerProgress] = ()) -> None:
        """Write the progress of runs and learners if a heartbeat is due."""
        if self._clock() - self._last >= HEARTBEAT_SECONDS:
            self._last = self._clock()
            with suppress(StorageError):  # heartbeats are not essential
                process, progress = Process.this(), tuple(learners)
                Heartbeat(self._holder, self._last, runs, False, process, progress).write(self._store)

    def end(self) -> None:
        """Write the final heartbeat, unless another campaign holds the root."""
        with suppress(StorageError):
            newest = Heartbeat.load(self._store)
            if newest is not None and newest.holder == self._holder:
                Heartbeat(self._holder, self._clock(), ended=True).write(self._store)


@dataclass(frozen=True)
class LeaseFile:
    """Holder, token and last renewal of a lease, as stored in its file.

    Attributes:
        holder: campaign, host and process, for messages.
        token: unique random string.
        renewed_at: time of the last renewal by the holder's clock, s since 1970.
        process: process of the holder, None if unknown.
    """

    holder: str
    token: str
    renewed_at: Seconds
    process: Process | None = None

    def is_dead(self, now: float, seconds: float) -> bool:
        """Return True if the lease has expired after `seconds`, or its process on this machine has ended."""
        return now - self.renewed_at >= seconds or (self.process is not None and self.process.is_dead())

    def is_ahead(self, now: float, seconds: float) -> bool:
        """Return True if the last renewal lies far in the future, which means that a clock is wrong."""
        return self.renewed_at - now >= seconds and not self.is_dead(now, seconds)


@dataclass(frozen=True)
class StopRequest:
    """Request to stop a lease's holder, identified by token, or by name if the lease is damaged."""

    token: str = ""
    holder: str = ""


LEASE_SECONDS: Final = 120.0  # time without renewal after which a lease expires, s
CREATION_SECONDS: Final = 0.2  # time allowed for creating a lease on a disk without hard links, s
STOP_CHECK_SECONDS: Final = 3.0  # minimum interval between checks for a stop request, s

logger = logging.getLogger(__name__)


class NotRunningError(ValueError):
    """Error raised if no campaign holds the results root."""


class RootInUseError(RefusedError):
    """Error raised if another campaign holds the results root, or has taken it over."""


class Lease:
    """Exclusive lease on a results root, valid as long as it is renewed at least every `seconds`.

    Leases are created and replaced by conditional writes (`Store.create`, `Store.replace`), so that exactly
    one of several processes gets it. On a network folder without locks, the lease is read back, and its first
    renewal rejects a second holder.

    A lease is free at once if its process on this machine has ended, or if it is damaged and no heartbeat
    shows a running campaign. A lease from the future, due to a wrong clock, is watched for half of
    `seconds`, in which a running holder renews it twice.

    A delayed request of a former holder to an object store may still arrive. Files stay whole then, and
    checksums reveal a replaced part.

    Args:
        store: store of the results root.
        holder: campaign, host and process, for messages.
        seconds: time without renewal after which the lease expires, s.
        clock: function that returns the current time, s since 1970.
        sleep: function that waits for some seconds.
    """

    def __init__(
        self,
        store: Store,
        holder: str,
        seconds: float = LEASE_SECONDS,
        clock: Callable[[], float] = time.time,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.store = store
        self.holder = holder
        self.seconds = seconds
        self._clock = clock
        self._sleep = sleep
        self._token = uuid4().hex
        self._renewed_at = 0.0
        self._asked, self._checked_at = False, -math.inf

    def __enter__(self) -> Self:
        self.acquire()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.release()
        except StorageError as unreleased:
            if error is None:
                raise
            logger.warning("%s; the lease stays, and is free once this process has ended", unreleased)

    def acquire(self) -> None:
        """Acquire the lease.

        Raises:
            RootInUseError: if another campaign holds it.
            ResultsRootError: if the store cannot be a results root.
        """
        self.store.check_location()
        silent = _readable(self.store)
        if silent is not None and silent.is_ahead(self._clock(), self.seconds):
            logger.warning(
                "the lease of %s on %s is %.0f s ahead of the clock here; watching it for %.0f s",
                silent.holder,
                self.store,
                silent.renewed_at - self._clock(),
                self.seconds / 2,
            )
            self._sleep(self.seconds / 2)
        else:
            silent = None
        current, version = _read(self.store)
        if isinstance(current, DamagedFileError):
            self._sleep(CREATION_SECONDS)
            current, version = _read(self.store)
        if isinstance(current, DamagedFileError):
            heartbeat = _beating(self.store, self._clock())
            if heartbeat is not None:
                self._refuse(LeaseFile(heartbeat.holder, "", heartbeat.at))
            logger.warning("%s; no campaign gives signs of life: it is replaced", current)
        elif (
            current is not None
            and current != silent
            and not self._is_ours(current)
            and not current.is_dead(self._clock(), self.seconds)
        ):
            self._refuse(current)
        if not self._write(current, version) or not self._is_ours(_read(self.store)[0]):
            self._refuse(_readable(self.store))

    def renew(self) -> None:
        """Renew the lease, or raise an error if another campaign holds it.

        Call it before publishing anything after a pause.

        Raises:
            RootInUseError: if another campaign has acquired the lease.
        """
        current, version = _read(self.store)
        if isinstance(current, DamagedFileError):
            logger.warning("%s; it is written again", current)
        elif not self._is_ours(current):
            self._refuse_renewal(current)
        if not self._write(current, version):
            self._refuse_renewal(_readable(self.store))

    def keep(self) -> None:
        """Renew the lease if a quarter of its time has passed; cheap enough to call in a loop."""
        if self._clock() - self._renewed_at >= self.seconds / 4:
            self.renew()

    def release(self) -> None:
        """Delete the lease, unless another campaign has replaced it."""
        try:
            self.renew()  # so that no other campaign can take it over before it is deleted
        except RootInUseError:
            return
        self.store.delete(STOP_FILE)
        self.store.delete(LEASE_FILE)

    def asked_to_stop(self) -> bool:
        """Return True if `ask_to_stop` was called for this holder; cheap enough to call in a loop."""
        if not self._asked and self._clock() - self._checked_at >= STOP_CHECK_SECONDS:
            self._checked_at = self._clock()
            try:
                request = self.store.read_json(STOP_FILE, StopRequest)
                self._asked = request.token == self._token or request.holder == self.holder
            except FileNotFoundError:
                self._asked = False
            except DamagedFileError as error:
                logger.warning("%s; ask again with tma-ray stop", error)
                self.store.delete(STOP_FILE)
        return self._asked

    def _refuse(self, current: LeaseFile | None) -> NoReturn:
        if current is None:
            raise RootInUseError(f"another campaign has started and left {self.store} meanwhile; try again")
        age = max(0.0, self._clock() - current.renewed_at)
        raise RootInUseError(
            f"{self.store} is in use by {current.holder}, last sign of life {age:.0f} s ago; "
            f"stop that campaign, wait {self.seconds - age:.0f} s if it is dead, or use another root"
        )

    def _refuse_renewal(self, taker: LeaseFile | None) -> NoReturn:
        name = taker.holder if taker else "nobody: its lease file is gone"
        raise RootInUseError(f"{self.holder} has lost {self.store} to {name}; start it again")

    def _is_ours(self, current: LeaseFile | DamagedFileError | None) -> bool:
        return isinstance(current, LeaseFile) and current.token == self._token

    def _write(self, current: LeaseFile | DamagedFileError | None, version: Version) -> bool:
        """Write this lease in place of `current`, or return False if another process was faster."""
        self._renewed_at = self._clock()
        lease = LeaseFile(self.holder, self._token, self._renewed_at, Process.this())
        data = json.dumps(asdict(lease)).encode()
        if current is None:
            written = self.store.create(LEASE_FILE, data)
        elif version is None:
            self.store.write_bytes(LEASE_FILE, data)
            written = True
        else:
            written = self.store.replace(LEASE_FILE, data, version)
        # if a response was lost, the repeated request finds this lease already written
        return written or self._is_ours(_read(self.store)[0])


def ask_to_stop(store: Store) -> str:
    """Ask the holder of a results root's lease to stop with checkpoints, and return the holder's name.

    Raises:
        NotRunningError: if no campaign holds the root.
        TypeError: if `store` is not a store.
    """
    check_type("store", store, Store, "a Store, as Store.open('results')")
    now, current = time.time(), _read(store)[0]
    if isinstance(current, DamagedFileError):
        heartbeat = _beating(store, now)
        if heartbeat is None:
            raise NotRunningError(
                f"{current}, and no campaign gives signs of life: there is nothing to stop"
            ) from current
        store.write_json(STOP_FILE, StopRequest(holder=heartbeat.holder))
        return heartbeat.holder
    if current is None:
        raise NotRunningError(f"no campaign is running on {store}: there is nothing to stop")
    if current.is_dead(now, LEASE_SECONDS):
        raise NotRunningError(f"{current.holder} is dead: there is nothing to stop on {store}")
    store.write_json(STOP_FILE, StopRequest(token=current.token))
    return current.holder


def holder_of(store: Store, seconds: float = LEASE_SECONDS) -> str | None:
    """Return the name of the running campaign that holds a results root, or None if there is none.

    If the lease is damaged or from the future, the last heartbeat decides.
    """
    now, current = time.time(), _read(store)[0]
    if current is None:
        return None
    if isinstance(current, LeaseFile) and not current.is_ahead(now, seconds):
        return None if current.is_dead(now, seconds) else current.holder
    heartbeat = _beating(store, now)
    return heartbeat.holder if heartbeat is not None else None


def _beating(store: Store, now: float) -> Heartbeat | None:
    """Return the heartbeat of a running campaign, or None if no campaign is running."""
    heartbeat = Heartbeat.load(store)
    return heartbeat if heartbeat is not None and heartbeat.alive(now) else None


def _read(store: Store) -> tuple[LeaseFile | DamagedFileError | None, Version]:
    """Return a root's lease (an error if damaged, None if missing) and the version of its file."""
    try:
        data, version = store.read_version(LEASE_FILE)
    except FileNotFoundError:
        return None, None
    except DamagedFileError as error:  # the path is not a file
        return error, None
    try:
        return decode_json(data, LeaseFile, store.where(LEASE_FILE)), version
    except DamagedFileError as error:
        return error, version


def _readable(store: Store) -> LeaseFile | None:
    lease, _ = _read(store)
    return lease if isinstance(lease, LeaseFile) else None

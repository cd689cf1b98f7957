"""One campaign at a time on a results root: its lease, and the heartbeat that shows it alive."""

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
    """A process, as others on its machine find it: start of the machine, namespace of the number, number."""

    boot: str
    namespace: str
    pid: SmallNatural

    @classmethod
    def this(cls) -> "Process | None":
        """Return this process, None where others could not find it."""
        try:
            boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
            namespace = str(Path("/proc/self/ns/pid").readlink())
        except OSError:
            return None
        return cls(boot, namespace, os.getpid())

    def is_dead(self) -> bool:
        """True if the process is known to have ended; one of another machine never is."""
        here = Process.this()
        if here is None or (self.boot, self.namespace) != (here.boot, here.namespace):
            return False
        return not Path(f"/proc/{self.pid}").exists()


HEARTBEAT_SECONDS: Final = 15.0  # time between two heartbeats, s
SILENT_SECONDS: Final = 120.0  # silence after which a campaign is taken to be dead, s


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
    """Recent progress of the learner of a cohort.

    Attributes:
        host: name of its machine.
        device: name of its device, as torch has it.
        width: number of its slots.
        runs: number of runs in them.
        updates_per_second: updates of single runs, 1/s.
        busy: share of the time with work, in [0, 1].
        memory_gib: memory in use, of the GPU, or by its process on a CPU, GiB.
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
    """Heartbeat of a campaign.

    Attributes:
        holder: campaign, host and process, as in the lease.
        at: time of writing, s since 1970.
        runs: the running runs by id.
        ended: True for the last one, of a campaign that has ended.
        process: process that wrote it; None where others could not find it.
        learners: learners of cohorts.
    """

    holder: str
    at: Seconds
    runs: Mapping[str, RunProgress] = field(default_factory=dict)
    ended: bool = False
    process: Process | None = None
    learners: tuple[LearnerProgress, ...] = ()

    @classmethod
    def load(cls, store: Store) -> Self | None:
        """Return the last heartbeat on a root; None if there is none, or none that can be read."""
        try:
            return store.read_json(HEARTBEAT_FILE, cls)
        except (FileNotFoundError, DamagedFileError):
            return None  # of no consequence: it only tells more than the manifests do

    def alive(self, now: float) -> bool:
        """True if its campaign is running, as far as can be known at `now`.

        A sign from the future is none: the clock of who gave it is wrong.
        """
        if self.ended or (self.process is not None and self.process.is_dead()):
            return False
        return abs(now - self.at) < SILENT_SECONDS

    def write(self, store: Store) -> None:
        """Replace the root's heartbeat by this one."""
        store.write_json(HEARTBEAT_FILE, self)


class HeartbeatWriter:
    """Write a campaign's heartbeats, not more often than every `HEARTBEAT_SECONDS`."""

    def __init__(self, store: Store, holder: str, clock: Callable[[], float] = time.time) -> None:
        self._store = store
        self._holder = holder
        self._clock = clock
        self._last = 0.0

    def beat(self, runs: Mapping[str, RunProgress], learners: Sequence[LearnerProgress] = ()) -> None:
        """Write the progress of running runs and learners, if it is time."""
        if self._clock() - self._last >= HEARTBEAT_SECONDS:
            self._last = self._clock()
            with suppress(StorageError):  # it is for those who watch: the next one will do
                process, theirs = Process.this(), tuple(learners)
                Heartbeat(self._holder, self._last, runs, False, process, theirs).write(self._store)

    def end(self) -> None:
        """Write that the campaign has ended, unless another one holds the root by now."""
        with suppress(StorageError):
            newest = Heartbeat.load(self._store)
            if newest is not None and newest.holder == self._holder:
                Heartbeat(self._holder, self._clock(), ended=True).write(self._store)


@dataclass(frozen=True)
class LeaseFile:
    """Content of a lease.

    Attributes:
        holder: campaign, host and process, for messages.
        token: random text of this lease alone.
        renewed_at: time of the last renewal, s since 1970 by the holder's clock.
        process: process of the holder; None where others could not find it.
    """

    holder: str
    token: str
    renewed_at: Seconds
    process: Process | None = None

    def is_dead(self, now: float, seconds: float) -> bool:
        """True if it was not renewed for `seconds`, or by a process of this machine that has ended."""
        return now - self.renewed_at >= seconds or (self.process is not None and self.process.is_dead())

    def is_ahead(self, now: float, seconds: float) -> bool:
        """True if it was renewed in the future: its clock or ours is wrong, and times tell nothing."""
        return self.renewed_at - now >= seconds and not self.is_dead(now, seconds)


@dataclass(frozen=True)
class StopRequest:
    """Ask a holder to leave: by the token of its lease, or by its name where that could not be read."""

    token: str = ""
    holder: str = ""


LEASE_SECONDS: Final = 120.0
"""Age over which a lease that nobody renewed is taken to be that of a killed process, s."""

MAKING_SECONDS: Final = 0.2
"""Time in which another process finishes the lease that it makes, where the disk has no hard links, s."""

STOP_CHECK_SECONDS: Final = 3.0  # time between two looks for a request to stop, s

logger = logging.getLogger(__name__)


class NotRunningError(ValueError):
    """No campaign holds the results root."""


class RootInUseError(RefusedError):
    """Another campaign holds the results root, or has taken it over."""


class Lease:
    """Lease that holds a results root as long as it is renewed, several times within `seconds`.

    Exactly one of several that ask at once gets it, in a folder of this machine and in a bucket: a new lease
    is made, and an old one replaced, only if nobody was faster (`Store.create`, `Store.replace`). A folder
    shared over a network needs locks for that once a lease has run out; where it has none, the lease is read
    back, and its first renewal refuses a second holder.

    The lease of a process that is known to be dead, because it ran on this machine, is free at once. So is
    one that cannot be read, unless a heartbeat shows that a campaign lives; a holder that finds its own
    damaged writes it again. Of one from the future, clocks tell nothing: it is watched for half of `seconds`,
    in which a living holder renews it twice, and is free if nothing has changed.

    A request to an object store that was sent before the lease was lost, and is still being tried, may
    arrive after another campaign has begun. Files stay whole then, and checksums tell of a part that was
    replaced.

    Args:
        store: the results root.
        holder: name of the campaign, host and process, for messages of others.
        seconds: time without renewal after which another may replace the lease, s.
        clock: current time, s since 1970; a holder whose clock is late by `seconds` is taken for dead.
        sleep: function that waits so many s.
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
        self._asked, self._looked_at = False, -math.inf

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
        """Acquire the lease if it is free, released, damaged, or no longer renewed.

        Raises:
            RootInUseError: another campaign renewed it less than `seconds` ago, or while it was watched.
            ResultsRootError: the place cannot be a results root.
        """
        self.store.check_place()
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
        found, version = _look(self.store)
        if isinstance(found, DamagedFileError):
            self._sleep(MAKING_SECONDS)
            found, version = _look(self.store)
        if isinstance(found, DamagedFileError):
            heartbeat = _beating(self.store, self._clock())
            if heartbeat is not None:
                self._refuse(LeaseFile(heartbeat.holder, "", heartbeat.at))
            logger.warning("%s; no campaign gives signs of life: it is replaced", found)
        elif (
            found is not None
            and found != silent
            and not self._is_ours(found)
            and not found.is_dead(self._clock(), self.seconds)
        ):
            self._refuse(found)
        if not self._write(found, version) or not self._is_ours(_look(self.store)[0]):
            self._refuse(_readable(self.store))

    def renew(self) -> None:
        """Renew the lease; to be called before anything is published after a pause.

        Raises:
            RootInUseError: another campaign has taken the lease over; publish nothing more.
        """
        found, version = _look(self.store)
        if isinstance(found, DamagedFileError):
            logger.warning("%s; it is written again", found)
        elif not self._is_ours(found):
            self._refuse_renewal(found)
        if not self._write(found, version):
            self._refuse_renewal(_readable(self.store))

    def keep(self) -> None:
        """Renew the lease, as `renew`, once a quarter of its time has passed; cheap enough for a loop."""
        if self._clock() - self._renewed_at >= self.seconds / 4:
            self.renew()

    def release(self) -> None:
        """Delete the lease; one that another campaign has replaced stays."""
        try:
            self.renew()  # nobody can take it over for a while: what is deleted next is ours
        except RootInUseError:
            return
        self.store.delete(STOP_FILE)
        self.store.delete(LEASE_FILE)

    def asked_to_stop(self) -> bool:
        """True if `ask_to_stop` was called for this holder; cheap enough for every turn of a loop."""
        if not self._asked and self._clock() - self._looked_at >= STOP_CHECK_SECONDS:
            self._looked_at = self._clock()
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

    def _is_ours(self, found: LeaseFile | DamagedFileError | None) -> bool:
        return isinstance(found, LeaseFile) and found.token == self._token

    def _write(self, found: LeaseFile | DamagedFileError | None, version: Version) -> bool:
        """Write our lease in place of what was found; returns False if somebody else was faster."""
        self._renewed_at = self._clock()
        lease = LeaseFile(self.holder, self._token, self._renewed_at, Process.this())
        data = json.dumps(asdict(lease)).encode()
        if found is None:
            written = self.store.create(LEASE_FILE, data)
        elif version is None:
            self.store.write_bytes(LEASE_FILE, data)
            written = True
        else:
            written = self.store.replace(LEASE_FILE, data, version)
        # The answer to a request may be lost, and its repetition then finds what it has written itself.
        return written or self._is_ours(_look(self.store)[0])


def ask_to_stop(store: Store) -> str:
    """Ask the campaign that holds a results root to stop with checkpoints; return its name.

    From any machine that sees the root. The campaign looks every few seconds.

    Raises:
        NotRunningError: nobody holds the root.
        TypeError: `store` is none.
    """
    check_type("store", store, Store, "a Store, as Store.open('results')")
    now, current = time.time(), _look(store)[0]
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
    """Return the name of the campaign that holds a results root, None if nobody alive does.

    Where the lease cannot be read, or is from the future, the last heartbeat tells.
    """
    now, current = time.time(), _look(store)[0]
    if current is None:
        return None
    if isinstance(current, LeaseFile) and not current.is_ahead(now, seconds):
        return None if current.is_dead(now, seconds) else current.holder
    heartbeat = _beating(store, now)
    return heartbeat.holder if heartbeat is not None else None


def _beating(store: Store, now: float) -> Heartbeat | None:
    """Return the last heartbeat of a campaign that is alive, None if there is none."""
    heartbeat = Heartbeat.load(store)
    return heartbeat if heartbeat is not None and heartbeat.alive(now) else None


def _look(store: Store) -> tuple[LeaseFile | DamagedFileError | None, Version]:
    """Return the lease of a root or why it cannot be read, and its version; None for what there is not."""
    try:
        data, version = store.read_version(LEASE_FILE)
    except FileNotFoundError:
        return None, None
    except DamagedFileError as error:  # something else lies in its place
        return error, None
    try:
        return decode_json(data, LeaseFile, store.where(LEASE_FILE)), version
    except DamagedFileError as error:
        return error, version


def _readable(store: Store) -> LeaseFile | None:
    found, _ = _look(store)
    return found if isinstance(found, LeaseFile) else None

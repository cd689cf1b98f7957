"""One campaign at a time on a results root."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self
from uuid import uuid4

from tma_ray.results.layout import LEASE_FILE, STOP_FILE
from tma_ray.results.storage.store import Store

LEASE_SECONDS: Final = 120.0
"""Age over which a lease that nobody renewed is taken to be that of a killed process, s."""

STOP_CHECK_SECONDS: Final = 3.0
"""How often a campaign looks whether it was asked to stop, s."""


class NotRunningError(ValueError):
    """No campaign holds the results root."""


class RootInUseError(RuntimeError):
    """Another campaign holds the results root, or has taken it over."""


class Lease:
    """Holds a results root as long as it is renewed, several times within `seconds`.

    No file system offers a lock that all of them have: two campaigns that start within the same
    instant may both get the lease. The first renewal then refuses one of them, a quarter of `seconds`
    later at most. The lease of a process that is known to be dead, because it ran on this machine, is
    free at once.

    An object store makes it no weaker, as long as it shows every write at once, as S3 and Google Cloud
    Storage do, and no stronger: a request that was sent before the lease was lost, and is still being
    tried, may arrive after another campaign has begun. Files stay whole then, and checksums tell of a
    part that was replaced.

    Args:
        store: the results root.
        holder: who asks, for the other's message: campaign, host, process.
        seconds: after how long without renewal the lease may be taken over, s.
        clock: current time, s; the clocks of two holders must agree within a small part of `seconds`.
    """

    def __init__(
        self,
        store: Store,
        holder: str,
        seconds: float = LEASE_SECONDS,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self.store = store
        self.holder = holder
        self.seconds = seconds
        self._clock = clock
        self._token = uuid4().hex
        self._renewed_at = 0.0
        self._asked, self._looked_at = False, -math.inf

    def __enter__(self) -> Self:
        self.acquire()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def acquire(self) -> None:
        """Takes the lease if it is free, released, or no longer renewed.

        Raises:
            RootInUseError: another campaign renewed it less than `seconds` ago.
        """
        current = _read(self.store, LEASE_FILE)
        if current is not None and current["token"] != self._token:
            now = self._clock()
            if _lives(current, now, self.seconds):
                age = now - current["renewed_at"]
                raise RootInUseError(
                    f"{self.store} is in use by {current['holder']}, last sign of life {age:.0f} s ago; "
                    f"stop that campaign, wait {self.seconds - age:.0f} s if it is dead, or use another root"
                )
        self._write()
        self.renew()  # reads back what another one may have written within the same instant

    def renew(self) -> None:
        """Gives a sign of life; to be called before anything is published after a pause.

        Raises:
            RootInUseError: another campaign has taken the lease over; publish nothing more.
        """
        current = _read(self.store, LEASE_FILE)
        if current is None or current["token"] != self._token:
            taker = current["holder"] if current else "nobody: its lease file is gone"
            raise RootInUseError(f"{self.holder} has lost {self.store} to {taker}; start it again")
        self._write()

    def keep(self) -> None:
        """Renews the lease if a quarter of its time has passed; cheap enough for every turn of a loop.

        Raises:
            RootInUseError: as `renew`.
        """
        if self._clock() - self._renewed_at >= self.seconds / 4:
            self.renew()

    def release(self) -> None:
        """Gives the lease back; one that was taken over stays with its holder."""
        current = _read(self.store, LEASE_FILE)
        if current is not None and current["token"] == self._token:
            self.store.delete(STOP_FILE)
            self.store.delete(LEASE_FILE)

    def asked_to_stop(self) -> bool:
        """Tells whether `ask_to_stop` was called for this holder; cheap enough for every turn of a loop."""
        if not self._asked and self._clock() - self._looked_at >= STOP_CHECK_SECONDS:
            self._looked_at = self._clock()
            request = _read(self.store, STOP_FILE)
            self._asked = request is not None and request["token"] == self._token
        return self._asked

    def _write(self) -> None:
        self._renewed_at = self._clock()
        content = {
            "holder": self.holder,
            "token": self._token,
            "renewed_at": self._renewed_at,
            "process": _this_process(),
        }
        self.store.write_bytes(LEASE_FILE, json.dumps(content).encode())


def ask_to_stop(store: Store, seconds: float = LEASE_SECONDS) -> str:
    """Asks the campaign that holds a results root to leave with checkpoints; returns how it is called.

    From any machine that sees the root. The campaign looks every few seconds.

    Raises:
        NotRunningError: nobody holds the root.
    """
    current = _read(store, LEASE_FILE)
    if current is None:
        raise NotRunningError(f"no campaign is running on {store}: there is nothing to stop")
    if not _lives(current, time.time(), seconds):
        raise NotRunningError(f"{current['holder']} is dead: there is nothing to stop on {store}")
    store.write_bytes(STOP_FILE, json.dumps({"token": current["token"]}).encode())
    return str(current["holder"])


def holder_of(store: Store, seconds: float = LEASE_SECONDS) -> str | None:
    """Returns how the campaign is called that holds a results root, None if nobody alive does."""
    current = _read(store, LEASE_FILE)
    return str(current["holder"]) if current is not None and _lives(current, time.time(), seconds) else None


def _read(store: Store, path: str) -> dict[str, Any] | None:
    try:
        content: dict[str, Any] = json.loads(store.read_bytes(path))
    except FileNotFoundError:
        return None
    return content


def _lives(lease: dict[str, Any], now: float, seconds: float) -> bool:
    """Tells whether who wrote `lease` may live: renewed less than `seconds` ago, and not known to be dead."""
    return now - lease["renewed_at"] < seconds and not _is_dead(lease.get("process"))


def _this_process() -> dict[str, Any] | None:
    """Names this process so that others on this machine can tell whether it lives; None where they cannot."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        namespace = str(Path("/proc/self/ns/pid").readlink())
    except OSError:
        return None
    return {"boot": boot, "namespace": namespace, "pid": os.getpid()}


def _is_dead(process: dict[str, Any] | None) -> bool:
    """Tells whether `process` is known to have ended; one of another machine never is."""
    here = _this_process()
    if process is None or here is None or {**process, "pid": here["pid"]} != here:
        return False
    return not Path(f"/proc/{process['pid']}").exists()

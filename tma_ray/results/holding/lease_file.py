"""The files in which holders of a results root say that they hold it, and others ask them to stop."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from enum import Enum, auto

from tma_ray.decoding import Seconds, decode_json
from tma_ray.results.holding.process import Process
from tma_ray.results.layout import LEASE_FILE, STOP_FILE
from tma_ray.results.storage.store import Store


class Standing(Enum):
    """State of a lease's holder, as far as the lease tells."""

    ALIVE = auto()
    """Renewed a short while ago."""
    DEAD = auto()
    """Not renewed for long, or by a process of this machine that has ended."""
    AHEAD = auto()
    """Renewed in the future: its clock or ours is wrong, and times tell nothing."""


@dataclass(frozen=True)
class LeaseFile:
    """Content of a lease.

    Attributes:
        holder: campaign, host and process, for messages.
        token: random, of this lease alone.
        renewed_at: last sign of life, s since 1970 by the holder's clock.
        process: the holder, None where others could not find it.
    """

    holder: str
    token: str
    renewed_at: Seconds
    process: Process | None = None

    @classmethod
    def load(cls, store: Store) -> LeaseFile | None:
        """Returns the lease of a root, None if there is none.

        Raises:
            DamagedFileError: there is one that cannot be read.
        """
        try:
            return decode_json(store.read_bytes(LEASE_FILE), cls, store.where(LEASE_FILE))
        except FileNotFoundError:
            return None

    def standing(self, now: float, seconds: float) -> Standing:
        """Returns whether the holder lives.

        Args:
            now: s since 1970.
            seconds: after how long without renewal a holder counts as dead.
        """
        if now - self.renewed_at >= seconds or (self.process is not None and self.process.is_dead()):
            return Standing.DEAD
        return Standing.AHEAD if self.renewed_at - now >= seconds else Standing.ALIVE

    def to_bytes(self) -> bytes:
        """Returns the content of the file."""
        return json.dumps(asdict(self)).encode()


@dataclass(frozen=True)
class StopRequest:
    """Asks a holder to leave: the one of a lease, or, where that could not be read, of a name.

    Attributes:
        token: of the lease, or empty.
        holder: its name, or empty.
    """

    token: str = ""
    holder: str = ""

    @classmethod
    def load(cls, store: Store) -> StopRequest | None:
        """Returns the request that lies on a root, None if there is none.

        Raises:
            DamagedFileError: there is one that cannot be read.
        """
        try:
            return decode_json(store.read_bytes(STOP_FILE), cls, store.where(STOP_FILE))
        except FileNotFoundError:
            return None

    def write(self, store: Store) -> None:
        """Puts the request on a root."""
        store.write_bytes(STOP_FILE, json.dumps(asdict(self)).encode())

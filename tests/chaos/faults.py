"""Disturbed campaigns: starting them, waiting for them, and comparing what they leave."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from small_runs import data_files, rows

from tma_ray.results import Table

HERE = Path(__file__).parent
ROOT = HERE.parents[1]

FLAGS = ("--checkpoint-seconds", "0.3", "--memory-per-run", "0.3")


@dataclass
class Fault:
    """What the table of faults says of one test.

    Attributes:
        name: of the fault.
        injected: how often.
        rows_lost: of all data tables, against the undisturbed campaign.
        bytes_different: likewise.
        recovery_seconds: from each fault until training went on.
    """

    name: str
    injected: int
    rows_lost: int
    bytes_different: int
    recovery_seconds: list[float] = field(default_factory=list)


@dataclass
class Site:
    """Where campaigns run and are disturbed.

    Attributes:
        folder: of results and requests.
        environment: of drivers.
        address: of the cluster.
        script: what a driver executes.
    """

    folder: Path
    environment: dict[str, str]
    address: str
    script: str = "chaos_campaign.py"

    @property
    def root(self) -> Path:
        """The results root."""
        return self.folder / "root"

    def ask(self, *requests: str) -> None:
        """Lets the first process that comes to each place do what the request says."""
        for request in requests:
            (self.requests / request).touch()

    def withdraw(self, *requests: str) -> None:
        """Ends what lasts as long as it is asked for."""
        for request in requests:
            (self.requests / request).unlink()

    def pending(self, *requests: str) -> bool:
        """Tells whether some of these have not been done yet."""
        return any((self.requests / request).exists() for request in requests)

    @property
    def requests(self) -> Path:
        """The folder of requests."""
        return Path(self.environment["TMA_SABOTAGE"])

    def start(self, *flags: str) -> subprocess.Popen[bytes]:
        """Starts the campaign's driver."""
        where = ("--address", self.address, "--results", str(self.root))
        command = [sys.executable, self.script, *where, *FLAGS, *flags]
        with (self.folder / "driver.txt").open("ab") as log:
            return subprocess.Popen(command, cwd=HERE, env=self.environment, stdout=log, stderr=log)

    def finish(self, driver: subprocess.Popen[bytes], code: int = 0) -> None:
        """Waits for the end of a driver, and for its exit code."""
        try:
            ended = driver.wait(timeout=300)
        finally:
            driver.kill()
        assert ended == code, (self.folder / "driver.txt").read_text()[-3000:]

    def compare(self, name: str, injected: int, undisturbed: dict[str, bytes], faults: list[float]) -> Fault:
        """Returns the difference from the undisturbed campaign, with the time to recover from each fault."""
        found = data_files(self.root)
        lost = sum(count_rows(data) for data in undisturbed.values()) - sum(map(count_rows, found.values()))
        different = sum(
            sum(a != b for a, b in zip(data, found.get(path, b""), strict=False))
            + abs(len(data) - len(found.get(path, b"")))
            for path, data in undisturbed.items()
        )
        assert set(found) == set(undisturbed)
        began = sorted(row["started_at"].timestamp() for row in rows(self.root, Table.ATTEMPTS))
        recovery = [min((at - fault for at in began if at > fault), default=float("nan")) for fault in faults]
        return Fault(name, injected, lost, different, recovery)

    def outcomes(self) -> list[str]:
        """Returns how the attempts ended, sorted."""
        return sorted(row["outcome"] for row in rows(self.root, Table.ATTEMPTS))

    def taken_up(self, attempt: int) -> bool:
        """Tells whether an attempt of this number, at whatever run, has written a checkpoint."""
        return any(f"-attempt-{attempt:03d}" in path.parent.name for path in self.checkpoints())

    def checkpoints(self) -> list[Path]:
        """Returns the indices of all complete checkpoints."""
        return sorted((self.root / "checkpoints").glob("*/*/index.json"))


def count_rows(data: bytes) -> int:
    """Returns the rows of an encoded table."""
    return int(pq.ParquetFile(pa.BufferReader(data)).metadata.num_rows)


def wait_for(condition: Callable[[], object], seconds: float = 120.0) -> float:
    """Waits until `condition` holds; returns the time of it, s since 1970."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.05)
    return time.time()


def kill(pid: int) -> None:
    """Kills a process that may have ended."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return

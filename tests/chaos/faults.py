"""Campaigns with injected faults: start, wait, and comparison of their results."""

from __future__ import annotations

import importlib
import math
import os
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from processes import cohort
from saboteur import HOLD
from small_runs import data_files, rows

from tma_ray.results import Committer, Store, Table
from tma_ray.runs import Placement, run_locally
from tma_ray.students.rollout_workers import CohortSettings

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
HELPERS = (HERE, HERE.parent / "runs")

Check, Compare = Callable[["Fault"], None], Callable[..., None]
"""Fixtures that fail after a loss."""

FLAGS = ("--checkpoint-seconds", "0.3", "--memory-per-run", "0.3")


@dataclass
class Fault:
    """Row of the table of faults: one test and its losses."""

    name: str
    injected: int
    rows_lost: int
    bytes_different: int
    recovery_seconds: list[float] = field(default_factory=list)  # from faults until training continued


@dataclass
class Site:
    """Environment of a campaign with faults."""

    folder: Path
    environment: dict[str, str]
    address: str | None  # None for a Ray started by the campaign
    script: str = "chaos_campaign.py"
    uri: str = ""  # of a results root outside of the folder

    def at(self, name: str) -> Site:
        """Delete earlier requests, and return a site in a new sub-folder."""
        for left in self.requests.iterdir():
            left.unlink()
        folder = self.folder / name
        folder.mkdir()
        return replace(self, folder=folder)

    @property
    def root(self) -> Path:
        return self.folder / "root"

    def ask(self, *requests: str) -> None:
        """Request faults, each from the first process that reaches its place in the code."""
        for request in requests:
            (self.requests / request).touch()

    def withdraw(self, *requests: str) -> None:
        for request in requests:
            (self.requests / request).unlink()

    def pending(self, *requests: str) -> bool:
        """Return True if a request has not been served yet."""
        return any((self.requests / request).exists() for request in requests)

    @property
    def requests(self) -> Path:
        return Path(self.environment["TMA_SABOTAGE"])

    def hold(self, *flags: str) -> subprocess.Popen[bytes]:
        """Start a driver whose runs are slowed down until `go_on`."""
        self.ask(HOLD)
        return self.start(*flags)

    def go_on(self, driver: subprocess.Popen[bytes] | None = None) -> None:
        """Continue the runs to the end of the campaign, under a new driver if there is none."""
        self.withdraw(HOLD)
        self.finish(driver or self.start())

    def trained(self, runs: int = 2) -> None:
        """Wait until `runs` runs have a checkpoint."""
        wait_for(lambda: len(self.newest_checkpoints()) == runs)

    def start(self, *flags: str) -> subprocess.Popen[bytes]:
        where = ("--local",) if self.address is None else ("--address", self.address)
        root = ("--results", self.uri or str(self.root))
        command = [sys.executable, self.script, *where, *root, *FLAGS, *flags]
        with (self.folder / "driver.txt").open("ab") as log:
            return subprocess.Popen(command, cwd=HERE, env=self.environment, stdout=log, stderr=log)

    def finish(self, driver: subprocess.Popen[bytes], code: int = 0) -> None:
        """Wait for the end of a driver, and check its exit code."""
        try:
            ended = driver.wait(timeout=600)
        finally:
            driver.kill()
        assert ended == code, (self.folder / "driver.txt").read_text()[-3000:]

    def compare(self, name: str, injected: int, undisturbed: dict[str, bytes], faults: list[float]) -> Fault:
        """Return the losses against the undisturbed campaign, and the recovery times."""
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

    def fetch(self, store: Store) -> None:
        """Copy a root from another store to the folder of this site."""
        for path in store.files():
            target = self.root / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(store.read_bytes(path))

    def outcomes(self) -> list[str]:
        return sorted(row["outcome"] for row in rows(self.root, Table.ATTEMPTS))

    def taken_up(self, attempt: int) -> bool:
        """Return True if any run's attempt of this number has written a checkpoint."""
        return any(f"-attempt-{attempt:03d}" in path.parent.name for path in self.checkpoints())

    def checkpoints(self) -> list[Path]:
        """Return the index files of all complete checkpoints."""
        return sorted((self.root / "checkpoints").glob("*/*/index.json"))

    def newest_checkpoints(self) -> list[Path]:
        """Return the index file of every run's newest complete checkpoint."""
        return sorted({path.parts[-3]: path for path in self.checkpoints()}.values())

    def last_checkpoint(self) -> float:
        """Return the time of the newest complete checkpoint, s since 1970; 0 without any."""
        stamps = Store.open(self.uri or self.root).stamps("checkpoints")
        times = [at / 1e9 for path, (at, _) in stamps.items() if path.endswith("/index.json") and at]
        return max(times, default=0.0)

    def attempts(self) -> set[tuple[str, str]]:
        """Return run and number of the attempts with existing checkpoints."""
        return {(path.parts[-3], path.parts[-2].rpartition("-")[2]) for path in self.checkpoints()}


def count_rows(data: bytes) -> int:
    return int(pq.ParquetFile(pa.BufferReader(data)).metadata.num_rows)


def wait_for(condition: Callable[[], object], seconds: float = 120.0) -> float:
    """Wait until a condition holds; return the time, s since 1970."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.05)
    return time.time()


def kill(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def private_environment(place: Path) -> dict[str, str]:
    """Return environment variables that isolate processes from other clusters and the user's home."""
    requests = place / "requests"
    requests.mkdir()
    kept = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    return kept | {
        "HOME": str(place),
        "RAY_TMPDIR": str(place),
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_worker_niceness": "0",  # with the default, drivers and tests starve the workers
        "PYTHONPATH": os.pathsep.join([*map(str, HELPERS), os.environ.get("PYTHONPATH", "")]),
        "TMA_SABOTAGE": str(requests),
    }


@cache
def undisturbed_files(
    module: str = "chaos_campaign", name: str = "CAMPAIGN", width: int = 0, seeds: int = 1
) -> dict[str, bytes]:
    """Return the data files of an undisturbed campaign, executed in this process without Ray.

    Runs learn alone, or in separate cohorts of a given width.
    """
    campaign = replace(getattr(importlib.import_module(module), name), seeds=tuple(range(seeds)))
    with tempfile.TemporaryDirectory() as root, ExitStack() as stack:
        learner = stack.enter_context(cohort(CohortSettings(width=width))) if width else None
        for spec in campaign.plan().runs:
            run_locally(spec, Committer.open(root), Placement(learner=learner))
        return data_files(root)


def table(faults: Sequence[Fault]) -> str:
    lines = ["| fault | injected | rows lost | bytes different | recovery, s |", "|---|---|---|---|---|"]
    for fault in faults:
        known = [f"{value:.1f}" for value in fault.recovery_seconds if not math.isnan(value)]
        seconds = " ".join(known) or "none needed"
        numbers = f"{fault.injected} | {fault.rows_lost} | {fault.bytes_different}"
        lines.append(f"| {fault.name} | {numbers} | {seconds} |")
    return "\n".join(lines)

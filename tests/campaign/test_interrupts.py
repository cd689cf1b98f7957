"""Ctrl-C on a real campaign in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

HELPERS = Path(__file__).parents[1] / "runs"
ARGUMENTS = (
    "campaign --environment corridor:Corridor --embodiments= --teachers random,alp_gmm --students ppo "
    "--seeds 1 --steps 40000 --evaluation-interval 10000 --memory-per-run 0.5 --checkpoint-seconds 1 "
    "--results"
)


def start(root: Path, said: Path | None = None) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tma_ray.cli", *ARGUMENTS.split(), str(root)]
    path = os.pathsep.join([str(HELPERS), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path}
    if said is None:
        return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)
    with said.open("ab") as log:
        return subprocess.Popen(command, env=environment, stdout=log, stderr=log)


def wait_for_a_checkpoint(root: Path, process: subprocess.Popen[bytes]) -> None:
    while not any(root.glob("checkpoints/*/*/index.json")):
        assert process.poll() is None, "the campaign ended before its first checkpoint"
        time.sleep(0.2)


def descendants(pid: int) -> set[int]:
    children = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            children.add(int(path.parent.name))
    return children.union(*(descendants(child) for child in children)) if children else set()


def alive(pids: set[int]) -> set[int]:
    """Those that still run, less Ray's own agents: of a killed node they take minutes to notice it."""
    return {pid for pid in pids if b"Agent" not in command_line(pid) and Path(f"/proc/{pid}").exists()}


def command_line(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def table_bytes(root: Path) -> dict[str, bytes]:
    tables = (
        root / "tables" / name
        for name in ("evaluations", "training", "episodes", "curriculum", "teacher_log")
    )
    return {
        path.name + path.parent.name: path.read_bytes()
        for table in tables
        for path in table.glob("*.parquet")
    }


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    root = tmp_path_factory.mktemp("undisturbed") / "root"
    assert start(root).wait(timeout=300) == 0
    tables = table_bytes(root)
    assert len(tables) == 10
    return tables


@pytest.mark.parametrize(
    ("numbers", "code"),
    [
        ((signal.SIGINT,), 130),
        ((signal.SIGTERM,), 130),
        ((signal.SIGINT, signal.SIGINT), 130),
        ((signal.SIGKILL,), -signal.SIGKILL),
    ],
)
def test_stopped_by_a_signal_and_continued(
    tmp_path: Path, undisturbed: dict[str, bytes], numbers: tuple[signal.Signals, ...], code: int
) -> None:
    process = start(tmp_path / "stopped")
    wait_for_a_checkpoint(tmp_path / "stopped", process)
    family = descendants(process.pid)
    for number in numbers:
        process.send_signal(number)
        time.sleep(0.05)
    assert process.wait(timeout=90) == code
    deadline = time.monotonic() + 30
    while alive(family) and time.monotonic() < deadline:
        time.sleep(0.5)
    assert not alive(family), "orphans"
    assert start(tmp_path / "stopped").wait(timeout=300) == 0
    assert table_bytes(tmp_path / "stopped") == undisturbed

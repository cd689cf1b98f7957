"""Ctrl-C on a real campaign in a process of its own."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from small_runs import data_files

pytestmark = pytest.mark.slow
HELPERS = Path(__file__).parents[1] / "runs"
ARGUMENTS = (
    "campaign --environment corridor:Corridor --embodiments= --teachers random,alp_gmm --students ppo "
    "--seeds 1 --steps 40000 --evaluation-interval 10000 --memory-per-run 0.5 --checkpoint-seconds 1 "
    "--results"
)


def start(
    root: Path, said: Path | None = None, *flags: str, environment: Mapping[str, str] = os.environ
) -> subprocess.Popen[bytes]:
    """Start the campaign beside its root: workers on this machine look into the driver's folder, too."""
    command = [sys.executable, "-m", "tma_ray", *ARGUMENTS.split(), str(root), *flags]
    path = os.pathsep.join([str(HELPERS), os.environ.get("PYTHONPATH", "")])
    with (said or Path(os.devnull)).open("wb") as log:
        errors = log if said else None
        environment = {**environment, "PYTHONPATH": path}
        return subprocess.Popen(command, cwd=root.parent, env=environment, stdout=log, stderr=errors)


def wait_for_a_checkpoint(root: Path, process: subprocess.Popen[Any] | None = None) -> None:
    """Wait as long as the process lives, or for two minutes."""
    deadline = time.monotonic() + 120
    while not any(root.glob("checkpoints/*/*/index.json")):
        assert process is None or process.poll() is None, "the campaign ended before its first checkpoint"
        assert process or time.monotonic() < deadline, "no checkpoint"
        time.sleep(0.1)


def living(processes: list[psutil.Process]) -> list[psutil.Process]:
    """Those that still run, less Ray's own agents: of a killed node they take minutes to notice it."""
    return [each for each in processes if each.is_running() and "Agent" not in "".join(command_line(each))]


def command_line(process: psutil.Process) -> list[str]:
    with suppress(psutil.Error):
        return process.cmdline()
    return []


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    root = tmp_path_factory.mktemp("undisturbed") / "root"
    assert start(root).wait(timeout=300) == 0
    tables = data_files(root)
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
def test_stopped_by_a_signal_and_continued(tmp_path, undisturbed, numbers, code):
    process = start(tmp_path / "stopped")
    wait_for_a_checkpoint(tmp_path / "stopped", process)
    family = psutil.Process(process.pid).children(recursive=True)
    for number in numbers:
        process.send_signal(number)
        time.sleep(0.05)
    assert process.wait(timeout=90) == code
    deadline = time.monotonic() + 30
    while living(family) and time.monotonic() < deadline:
        time.sleep(0.5)
    assert not living(family), "orphans"
    assert start(tmp_path / "stopped").wait(timeout=300) == 0
    assert data_files(tmp_path / "stopped") == undisturbed

"""A campaign on a Ray of its own: where its processes listen, and what the death of their head leaves."""

import ipaddress
import os
import signal
import stat
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil
import pytest
from small_runs import rows
from test_interrupts import start, wait_for_a_checkpoint

from tma_ray.campaign.progress import overview
from tma_ray.console.exit_codes import RAY_LOST
from tma_ray.results import Table

pytestmark = pytest.mark.slow


def family(pid: int) -> list[psutil.Process]:
    driver = psutil.Process(pid)
    return [driver, *driver.children(recursive=True)]


def listening(processes: list[psutil.Process]) -> dict[tuple[str, int], str]:
    """Return what process listens at which address and port."""
    sockets = ((socket, process) for process in processes for socket in process.net_connections("inet"))
    return {tuple(s.laddr): process.name() for s, process in sockets if s.status == psutil.CONN_LISTEN}


def is_loopback(address: str) -> bool:
    found = ipaddress.ip_address(address)
    return (getattr(found, "ipv4_mapped", None) or found).is_loopback


def assert_ends_soon_with_nothing_left(
    driver: subprocess.Popen[bytes], processes: list[psutil.Process], said: Path
) -> None:
    """Once one of its Ray's core processes has been killed."""
    killed = time.monotonic()
    assert driver.wait(timeout=60) == RAY_LOST
    assert time.monotonic() - killed < 15
    _, left = psutil.wait_procs(processes, timeout=3)
    assert left == []
    assert "same command" in said.read_text()
    assert "Traceback" not in said.read_text()


def folders_of_ray(processes: list[psutil.Process]) -> set[Path]:
    """Return the folders in which processes keep open files of Ray."""
    opened = {Path(file.path) for process in processes for file in process.open_files()}
    return {folder for path in opened for folder in path.parents if folder.name == "ray"}


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM], ids=["killed", "terminated"])
@pytest.mark.parametrize("core", ["gcs_server", "raylet"])
def test_is_closed_and_ends_with_a_core_process(tmp_path: Path, core: str, number: signal.Signals) -> None:
    root, said = tmp_path / "root", tmp_path / "said.txt"
    driver = start(root, said)
    try:
        wait_for_a_checkpoint(root, driver)
        processes = family(driver.pid)
        sockets = listening(processes)
        assert {"gcs_server", "raylet"} <= set(sockets.values())
        assert [place for place in sockets if not is_loopback(place[0])] == []
        (folder,) = {path.parent for path in folders_of_ray(processes)}
        assert folder.name.startswith("tma_ray-")
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700

        next(process for process in processes if process.name() == core).send_signal(number)
        assert_ends_soon_with_nothing_left(driver, processes, said)
    finally:
        driver.kill()
    assert {row["outcome"] for row in rows(root, Table.ATTEMPTS)} == {"lost"}
    found = overview(root, time.time())
    assert found.heartbeat.ended
    states = {run.state for cells in found.campaigns.values() for runs in cells.values() for run in runs}
    assert states <= {"interrupted", "waiting"}


def test_nothing_of_a_campaign_that_has_ended_is_left(tmp_path: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="r", dir="/tmp") as place:  # short enough for sockets
        flags = f"--teachers random --students ppo --seeds 1 --steps 1000 --results {tmp_path / 'root'}"
        command = [sys.executable, "-m", "tma_ray", "campaign", "--local", *flags.split()]
        subprocess.run(command, check=True, env={**os.environ, "TMPDIR": place}, timeout=300)
        assert list(Path(place).glob("tma_ray-*")) == []


@pytest.mark.parametrize("core", ["gcs_server", "raylet"])
def test_a_ray_that_dies_while_it_starts_ends_the_driver_with_a_message(tmp_path: Path, core: str) -> None:
    said = tmp_path / "said.txt"
    driver = start(tmp_path / "root", said)
    try:
        while "raylet" not in (names := {each.name(): each for each in family(driver.pid)}):
            assert driver.poll() is None, "the driver ended before Ray had started"
            time.sleep(0.05)
        processes = family(driver.pid)
        names[core].kill()
        assert_ends_soon_with_nothing_left(driver, processes, said)
    finally:
        driver.kill()
    assert list((tmp_path / "root").rglob("*.parquet")) == []


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system has no CPU affinity")
def test_has_the_cores_of_this_process_alone() -> None:
    script = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "import ray; from tma_ray.campaign.cluster.connection import LocalHead; LocalHead({})\n"
        "print(ray.cluster_resources()['CPU'])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["1.0"], done.stderr

"""Which processes of its own Ray a driver cannot do without."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import psutil

from tma_ray.campaign.cluster.heads import OwnProcesses


def test_children_of_the_node_manager_may_end_and_the_node_manager_may_not(tmp_path: Path) -> None:
    """Until they are workers, they bear its name."""
    bash = shutil.which("bash")
    assert bash is not None
    raylet = shutil.copy(bash, tmp_path / "raylet")
    processes = OwnProcesses()
    with subprocess.Popen(
        [raylet, "-c", f"{raylet} -c 'echo; read line'; echo; read line"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as node:
        assert node.stdin is not None and node.stdout is not None  # noqa: PT018
        node.stdout.readline()
        (child,) = psutil.Process(node.pid).children()
        assert child.name() == "raylet"
        assert processes.lost() is None
        node.stdin.write("\n")
        node.stdin.flush()
        node.stdout.readline()
        assert not child.is_running()
        assert processes.lost() is None
        node.kill()
        node.wait()
        assert "node manager (raylet)" in str(processes.lost())


def test_what_has_closed_its_ports_is_lost_while_its_process_goes_on(tmp_path: Path) -> None:
    """As the head is after SIGTERM: it neither serves nor ends."""
    python = tmp_path / "gcs_server"
    python.symlink_to(sys.executable)
    processes = OwnProcesses()
    code = (
        "import socket, sys; sys.stdin.readline(); server = socket.create_server(('127.0.0.1', 0))\n"
        "print(flush=True); sys.stdin.readline(); server.close(); print(flush=True); sys.stdin.readline()"
    )
    with subprocess.Popen(
        [python, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as head:
        assert head.stdin is not None and head.stdout is not None  # noqa: PT018
        assert processes.lost() is None, "it has not begun to serve"
        for lost in (False, True):
            head.stdin.write("\n")
            head.stdin.flush()
            head.stdout.readline()
            assert ("head (GCS)" in str(processes.lost())) is lost
        assert head.poll() is None
        head.kill()

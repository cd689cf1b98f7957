"""The head of a cluster that a campaign has joined: without tma_ray, and gone for longer than Ray waits."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from local_head import Head, local_head
from test_interrupts import ARGUMENTS, HELPERS, wait_for_a_checkpoint

from tma_ray.commands.exits import RAY_LOST, REFUSED

PATIENCE = 40
"""How long this cluster's processes wait for their head, s."""


def start(head: Head, root: Path, said: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tma_ray.cli", *ARGUMENTS.split(), str(root), "--address", head.address]
    path = os.pathsep.join([str(HELPERS), os.environ.get("PYTHONPATH", "")])
    with said.open("wb") as log:
        environment = {**head.environment, "PYTHONPATH": path}
        # Workers on this machine look into the driver's folder, too.
        return subprocess.Popen(command, cwd=root.parent, env=environment, stdout=log, stderr=log)


def global_control_store(head: Head) -> psutil.Process:
    port = head.address.rpartition(":")[2]
    servers = (process for process in psutil.process_iter() if process.name() == "gcs_server")
    return next(server for server in servers if f"--gcs_server_port={port}" in server.cmdline())


@pytest.mark.slow
def test_workers_without_tma_ray_are_refused_and_a_head_that_is_gone_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    damaged = tmp_path / "path" / "tma_ray"
    damaged.mkdir(parents=True)
    (damaged / "__init__.py").write_text("raise ImportError('there is none here')")
    path = [str(damaged.parent), str(HELPERS), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path))
    root, said = tmp_path / "root", tmp_path / "said.txt"
    setting = f'--system-config={{"gcs_rpc_server_reconnect_timeout_s": {PATIENCE}}}'
    with local_head(setting) as head:
        monkeypatch.setenv("PYTHONPATH", path[-1])
        assert start(head, root, said).wait(timeout=120) == REFUSED
        assert "none that can be imported" in said.read_text()
        assert "in the environment in which 'ray start' is called on that node" in said.read_text()
        assert not root.exists()

        shutil.rmtree(damaged)
        driver = start(head, root, said)
        try:
            wait_for_a_checkpoint(root, driver)
            server = global_control_store(head)
            server.send_signal(signal.SIGKILL)
            killed = time.monotonic()
            assert driver.wait(timeout=120) == RAY_LOST, said.read_text()
        finally:
            driver.kill()
        assert time.monotonic() - killed > PATIENCE / 2
        assert "has not answered" in said.read_text()
        assert "the same command continues" in said.read_text()
        assert "Traceback" not in said.read_text()

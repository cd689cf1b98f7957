"""A cluster whose first worker comes when runs already wait for it, as an autoscaler's do; and its cost."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from local_head import RAY, local_head

from tma_ray.results import Results, RunStatus

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_runs_wait_for_nodes_only_where_some_will_come(tmp_path: Path) -> None:
    flags = (
        "--teachers random --seeds 2 --steps 1000 --evaluation-interval 1000 --probe-interval 1000 "
        f"--training-window 1000 --memory-per-run 0.5 --results {tmp_path / 'root'}"
    )
    with local_head("--num-cpus=0") as head:
        command = [sys.executable, "experiments/quickstart.py", "--address", head.address, *flags.split()]
        refused = subprocess.run(command, cwd=ROOT, env=head.environment, capture_output=True, text=True)
        assert refused.returncode == 2
        assert "give '--autoscaling' if the cluster adds them by itself" in refused.stderr
        assert not (tmp_path / "root").exists()

        campaign = subprocess.Popen(
            [*command, "--autoscaling"], cwd=ROOT, env=head.environment, stdout=subprocess.PIPE, text=True
        )
        assert campaign.stdout is not None
        assert any("0/2 runs done, 2 waiting" in line for line in campaign.stdout)
        node = subprocess.Popen(
            [RAY, "start", "--block", f"--address={head.address}", "--num-cpus=2",
             "--object-store-memory=100000000", "--dashboard-agent-listen-port=0"],
            env=head.environment, stdout=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        try:
            assert campaign.wait(timeout=300) == 0
        finally:
            node.send_signal(signal.SIGTERM)
            node.wait(timeout=60)
            campaign.kill()
    assert [run.status for run in Results.open(tmp_path / "root").runs()] == [RunStatus.DONE] * 2


@pytest.mark.slow
def test_a_long_campaign_is_refused_on_a_cluster_though_it_has_a_terminal(tmp_path: Path) -> None:
    """As ``ray submit --tmux`` starts it, where nobody would see a question."""
    watched, terminal = pty.openpty()
    with local_head("--num-cpus=7", "--memory=50000000000") as head:
        command = [sys.executable, "experiments/quickstart.py", "--students", "sac", "--steps", "20M"]
        refused = subprocess.run(
            [*command, "--address", head.address, "--results", tmp_path / "root"],
            cwd=ROOT, env=head.environment, stdin=terminal, stdout=terminal, stderr=subprocess.PIPE,
            text=True, timeout=100, check=False,
        )  # fmt: skip
    shown = os.read(watched, 10_000).decode()
    assert refused.returncode == 2
    assert "with 6 runs at once on the cluster's 1 node" in shown
    assert "pass --yes" in refused.stderr
    assert not (tmp_path / "root").exists()

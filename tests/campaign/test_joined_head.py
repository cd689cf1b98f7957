"""Clusters that a campaign joins, by an address or as a job: damaged and lost heads, and later nodes."""

import os
import pty
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import psutil
import pytest
from local_head import RAY, Head, local_head
from small_runs import data_files, rows
from test_interrupts import HELPERS, start, wait_for_a_checkpoint

from tma_ray.console.exit_codes import RAY_LOST, REFUSED
from tma_ray.results import Results, RunStatus, Table

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]

PATIENCE = 40
"""How long this cluster's processes wait for their head, s."""


def global_control_store(head: Head) -> psutil.Process:
    port = head.address.rpartition(":")[2]
    servers = (process for process in psutil.process_iter() if process.name() == "gcs_server")
    return next(server for server in servers if f"--gcs_server_port={port}" in server.cmdline())


def test_workers_without_tma_ray_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    damaged = tmp_path / "path" / "tma_ray"
    damaged.mkdir(parents=True)
    (damaged / "__init__.py").write_text("raise ImportError('there is none here')")
    path = [str(damaged.parent), str(HELPERS), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path))
    root, said = tmp_path / "root", tmp_path / "said.txt"
    setting = f'--system-config={{"gcs_rpc_server_reconnect_timeout_s": {PATIENCE}}}'
    with local_head(setting) as head:
        monkeypatch.setenv("PYTHONPATH", path[-1])
        joined = partial(start, root, said, "--address", head.address, environment=head.environment)
        assert joined().wait(timeout=120) == REFUSED
        assert "none that can be imported" in said.read_text()
        assert "in the environment in which 'ray start' is called on that node" in said.read_text()
        assert not root.exists()

        shutil.rmtree(damaged)
        driver = joined()
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

        place = {"cwd": ROOT, "env": head.environment}
        campaign = subprocess.Popen([*command, "--autoscaling"], stdout=subprocess.PIPE, text=True, **place)
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


ONLY_THERE = "--memory-per-run=1000"
"""GiB: more than this machine has, and less than the head node claims, so that runs can be there only."""


@pytest.fixture(scope="module")
def head() -> Iterator[Head]:
    with local_head(f"--memory={4000 * 2**30}", dashboard=True) as head:
        yield head


def jobs(head: Head, *arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    action, *rest = arguments
    command = [str(RAY), "job", action, "--address", head.jobs, *rest]
    done = subprocess.run(command, cwd=cwd, env=head.environment, capture_output=True, text=True, timeout=300)
    sys.stdout.write(f"$ ray job {' '.join(arguments)}\n{done.stdout}{done.stderr}\n")  # for `pytest -s`
    return done


def test_a_submitted_experiment_runs_there_and_exits_with_its_code(head: Head, tmp_path: Path) -> None:
    root = tmp_path / "root"
    script = (
        f"quickstart.py --address auto --seeds 1 --steps 2000 --evaluation-interval 2000 "
        f"--probe-interval 1000 --training-window 1000 --results {root} {ONLY_THERE}"
    )
    done = jobs(head, "submit", "--working-dir", "experiments", "--", sys.executable, *script.split())
    assert done.returncode == 0
    assert "2/2 runs done" in done.stdout
    runs = Results.open(root).runs()
    assert {run.run.teacher for run in runs} == {"random", "alp_gmm"}
    assert all(run.status is RunStatus.DONE for run in runs)
    assert len({row["step"] for row in rows(root, Table.EVALUATIONS)}) == 2

    wrong = script.replace("--seeds 1", "--teachers alp_gm")
    refused = jobs(head, "submit", "--working-dir", "experiments", "--", sys.executable, *wrong.split())
    assert refused.returncode == 1
    assert "did you mean 'alp_gmm'" in refused.stdout + refused.stderr


def test_a_stopped_job_leaves_checkpoints_and_the_same_command_continues(head: Head, tmp_path: Path) -> None:
    """Without an address: Ray tells the job its cluster; with a teacher and an environment of the user's."""
    root, undisturbed = tmp_path / "root", tmp_path / "undisturbed"

    def submit(name: str, results: Path, *options: str) -> subprocess.CompletedProcess[str]:
        script = (
            f"experiment.py --teachers frontier_teacher:Frontier --seeds 1 --steps 8000 "
            f"--evaluation-interval 8000 --checkpoint-seconds 0.5 --results {results} {ONLY_THERE}"
        )
        flags = "--submission-id", name, "--working-dir", "examples", *options
        return jobs(head, "submit", *flags, "--", sys.executable, *script.split())

    assert submit("first", root, "--no-wait").returncode == 0
    wait_for_a_checkpoint(root)
    assert "'first' was stopped" in jobs(head, "stop", "first").stdout
    assert [row["outcome"] for row in rows(root, Table.ATTEMPTS)] == ["stopped"]
    assert submit("second", root).returncode == 0
    assert sorted(row["outcome"] for row in rows(root, Table.ATTEMPTS)) == ["done", "stopped"]
    assert submit("undisturbed", undisturbed).returncode == 0
    assert data_files(root) == data_files(undisturbed)


def test_the_wrong_token_joins_nothing_and_says_so(head: Head, tmp_path: Path) -> None:
    token = tmp_path / "token"
    token.write_text("0" * 64)
    command = [sys.executable, "experiments/quickstart.py", "--address", head.address]
    environment = head.environment | {"RAY_AUTH_TOKEN_PATH": str(token)}
    options = {"cwd": ROOT, "env": environment, "capture_output": True, "text": True, "timeout": 120}
    refused = subprocess.run([*command, "--results", str(tmp_path / "root")], **options)
    assert refused.returncode == 2
    assert f"no Ray cluster was joined at '{head.address}'" in refused.stderr
    assert "RAY_AUTH_TOKEN_PATH" in refused.stderr
    assert not (tmp_path / "root").exists()

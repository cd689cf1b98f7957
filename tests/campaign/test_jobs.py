"""`ray job submit` to a head node, as docs/clusters.md describes it."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from local_head import RAY, Head, local_head
from small_runs import data_files, rows
from test_interrupts import wait_for_a_checkpoint

from tma_ray.results import Results, RunStatus, Table

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]

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

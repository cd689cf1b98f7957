"""The batch script for Slurm, with its commands played on this machine and a real Ray."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from local_head import free_ports
from small_runs import rows
from test_interrupts import wait_for_a_checkpoint

from tma_ray.results import Table

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "docs" / "slurm.sh"

SRUN = """#!/bin/bash
nodes=$SLURM_JOB_NUM_NODES tasks=$SLURM_NTASKS
while [[ $1 == -* ]]; do
    case "$1" in
        --nodes=*) nodes=${1#*=} ;;
        --ntasks=*) tasks=${1#*=} ;;
    esac
    shift
done
if ((tasks > nodes)); then
    echo "srun: error: Unable to create step for job: More processors requested than permitted" >&2
    exit 1
fi
exec "$@"
"""
"""A step inherits the job's tasks, and each node has the cores for one."""

SCONTROL = """#!/bin/bash
case "$1" in
    show) echo localhost; echo localhost ;;
    requeue) echo "$2" >> "$REQUEUED" ;;
esac
"""

ARGUMENTS = (
    "experiments/quickstart.py --teachers random --seeds 1 --steps 20000 --evaluation-interval 20000 "
    "--memory-per-run 0.5 --checkpoint-seconds 0.5 --results"
)


def test_the_script_is_bash_and_asks_for_a_signal_in_time() -> None:
    subprocess.run(["bash", "-n", SCRIPT], check=True)
    text = SCRIPT.read_text()
    assert "#SBATCH --requeue\n" in text
    assert "#SBATCH --signal=B:TERM@120\n" in text
    assert "ray stop" not in text, "it would end the Rays of other jobs on the node"
    assert "| head" not in text, "what writes after the first line fails by SIGPIPE, and so does the script"


@pytest.fixture
def environment(tmp_path: Path) -> Iterator[dict[str, str]]:
    """An allocation of two nodes, both of which are this machine."""
    commands = tmp_path / "bin"
    commands.mkdir()
    for name, text in {"srun": SRUN, "scontrol": SCONTROL}.items():
        (commands / name).write_text(text)
        (commands / name).chmod(0o755)
    (commands / "python").symlink_to(sys.executable)
    (port,) = free_ports(1)
    with tempfile.TemporaryDirectory(prefix="job", ignore_cleanup_errors=True) as place:
        kept = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
        path = f"{commands}:{Path(sys.executable).parent}:{os.environ['PATH']}"
        own = {"HOME": str(tmp_path), "PATH": path, "TMA_RAY_VENV": str(Path(sys.executable).parents[1])}
        job = {"TMPDIR": place, "JOB_ID": str(port), "JOB_NODELIST": "localhost,localhost"}
        job |= {"JOB_NUM_NODES": "2", "NTASKS": "2", "CPUS_PER_TASK": "1", "MEM_PER_NODE": "4096"}
        slurm = {f"SLURM_{name}": value for name, value in job.items()}
        yield {**kept, **own, **slurm, "REQUEUED": str(tmp_path / "requeued")}


@pytest.mark.slow
def test_a_campaign_asked_to_leave_is_queued_again(environment: dict[str, str], tmp_path: Path) -> None:
    root = tmp_path / "root"

    def start() -> subprocess.Popen[str]:
        command = ["bash", SCRIPT, *ARGUMENTS.split(), str(root)]
        return subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            start_new_session=True,
        )  # fmt: skip

    job = start()
    wait_for_a_checkpoint(root, job)
    os.kill(job.pid, signal.SIGTERM)  # the batch shell alone, as --signal=B: does
    output, _ = job.communicate(timeout=120)
    assert job.returncode == 130, output
    assert Path(environment["REQUEUED"]).read_text().split() == [environment["SLURM_JOB_ID"]]
    assert not list(Path(environment["SLURM_TMPDIR"]).iterdir()), "Ray's files are gone"
    deadline = time.monotonic() + 20
    while left := of_this_job(environment):  # a worker ends when it sees that its node has
        assert time.monotonic() < deadline, left
        time.sleep(0.1)

    again = start()
    output, _ = again.communicate(timeout=300)
    assert again.returncode == 0, output
    assert "1/1 runs done" in output
    assert output.count("Ray runtime started") == 2, "a head and one more node"
    attempts = sorted(rows(root, Table.ATTEMPTS), key=lambda row: row["attempt"])
    assert [row["outcome"] for row in attempts] == ["stopped", "done"]
    assert json.loads(attempts[0]["fingerprint"])["device"] == "cpu"
    assert len(Path(environment["REQUEUED"]).read_text().split()) == 1, "what is done is not queued again"


def test_without_ray_the_script_says_where_it_looked(environment: dict[str, str], tmp_path: Path) -> None:
    path = os.pathsep.join([str(tmp_path / "bin"), "/usr/bin", "/bin"])
    without = {**environment, "TMA_RAY_VENV": str(tmp_path / "none"), "PATH": path}
    ended = subprocess.run(["bash", SCRIPT], env=without, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert f"no Ray in {tmp_path / 'none'}" in ended.stderr
    assert "TMA_RAY_VENV" in ended.stderr


@pytest.mark.parametrize("trap", ["file", "link"])
def test_a_folder_of_another_user_is_not_used(environment: dict[str, str], tmp_path: Path, trap: str) -> None:
    place = Path(environment["SLURM_TMPDIR"]) / f"ray-{environment['SLURM_JOB_ID']}"
    (tmp_path / "theirs").mkdir()
    place.symlink_to(tmp_path / "theirs") if trap == "link" else place.touch()
    ended = subprocess.run(["bash", SCRIPT], env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert f"{place} cannot be used" in ended.stderr
    assert list((tmp_path / "theirs").iterdir()) == []


def of_this_job(environment: dict[str, str]) -> list[str]:
    """Return the command lines of processes that know this job, other than Ray's agents, which end later."""
    place = environment["SLURM_TMPDIR"]
    processes = [process.info for process in psutil.process_iter(["cmdline", "environ"])]
    own = (each for each in processes if (each["environ"] or {}).get("SLURM_TMPDIR") == place)
    lines = (" ".join(each["cmdline"] or ()) for each in own)
    return [line for line in lines if line and "Agent" not in line]

"""`docs/slurm.sh` on a real Slurm: one to three nodes, time limits, precedence, `scancel`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from bed import VENV, Bed, bed_of, wait_until
from checkout import CAMPAIGN
from slurm import Slurm, missing_daemons
from small_runs import data_files, rows

from tma_ray.results import Table

pytestmark = pytest.mark.skipif(missing_daemons() is not None, reason=str(missing_daemons()))

JOB = "--cpus-per-task=2 --mem=6G --time=30 docs/slurm.sh"

LONG = CAMPAIGN.replace("--steps 20000", "--steps 600000")
"""Runs that no time limit of a few minutes lets end."""


@pytest.fixture(scope="module")
def bed() -> Iterator[Bed]:
    with bed_of("one", "two", "three") as bed:
        yield bed


@pytest.fixture(scope="module")
def slurm(bed: Bed, wheel: Path) -> Slurm:
    return Slurm(bed, wheel)


@pytest.fixture(scope="module")
def undisturbed(slurm: Slurm) -> dict[str, bytes]:
    """Tables of `CAMPAIGN` as a single machine makes them."""
    slurm.run(f"{VENV}/bin/python {CAMPAIGN} --local --results /shared/undisturbed")
    return data_files(slurm.shared / "undisturbed")


@pytest.mark.parametrize("nodes", [1, 2, 3])
def test_a_campaign_trains_on_all_nodes_of_its_job(
    slurm: Slurm, undisturbed: dict[str, bytes], nodes: int
) -> None:
    job = slurm.submit(f"--nodes={nodes} {JOB} {CAMPAIGN} --results /shared/on-{nodes}")
    assert slurm.ended(job) == "COMPLETED 0:0", slurm.log(job)
    root = slurm.shared / f"on-{nodes}"
    assert data_files(root) == undisturbed
    assert "4/4 runs done" in slurm.run(f"{VENV}/bin/tma-ray status /shared/on-{nodes}")
    assert (len({row["host"] for row in rows(root, Table.ATTEMPTS)}) > 1) == (nodes > 1)
    for node in slurm.nodes:
        assert "raylet" not in node.run("ps ax -o args; ls /tmp/ray-* 2>/dev/null", code=None, shown=False)


def test_without_a_virtual_environment_the_job_says_how_one_is_named(slurm: Slurm) -> None:
    job = slurm.submit("--nodes=1 --chdir=/shared --cpus-per-task=1 --mem=1G docs/slurm.sh none.py")
    assert slurm.ended(job) == "FAILED 2:0"
    assert "TMA_RAY_VENV" in (slurm.shared / f"tma-ray-{job}.log").read_text()


def test_a_job_at_its_time_limit_is_queued_again_until_its_campaign_is_done(
    slurm: Slurm, undisturbed: dict[str, bytes]
) -> None:
    """The limit is over before the runs are, at least once; also while a requeued job still waits."""
    root = slurm.shared / "limit"
    slow = CAMPAIGN.replace("--checkpoint-seconds 1", "--checkpoint-seconds 0.2")
    job = slurm.submit(f"--nodes=2 {JOB} {slow} --results /shared/limit")
    wait_until(lambda: any(root.glob("checkpoints/*/*/index.json")), 300)
    # As --signal=B:TERM@120 has it sent to the batch shell before the limit.
    slurm.run(f"scancel --batch --signal=TERM {job}")
    wait_until(lambda: slurm.state(job).startswith("PENDING"), 120)
    slurm.run(f"scontrol update JobId={job} StartTime=now")
    wait_until(lambda: slurm.state(job).startswith("RUNNING"), 240)
    wait_until(lambda: slurm.log(job).count("Ray runtime started") == 4, 120)
    slurm.run(f"scancel --batch --signal=TERM {job}")
    wait_until(lambda: slurm.state(job).startswith("PENDING"), 120)
    slurm.run(f"scontrol update JobId={job} StartTime=now")
    assert slurm.ended(job) == "COMPLETED 0:0", slurm.log(job)
    assert data_files(root) == undisturbed
    assert {row["outcome"] for row in rows(root, Table.ATTEMPTS)} == {"stopped", "done"}


def test_slurm_itself_ends_a_life_at_the_limit_and_the_next_one_resumes(slurm: Slurm) -> None:
    root = slurm.shared / "lives"
    limit = JOB.replace("--time=30", "--time=8")
    job = slurm.submit(f"--nodes=1 {limit} {LONG} --results /shared/lives")
    wait_until(lambda: slurm.restarts(job) == 1 and slurm.state(job).startswith("RUNNING"), 900)
    assert {row["outcome"] for row in rows(root, Table.ATTEMPTS)} == {"stopped"}
    wait_until(lambda: '"attempt": 1' in "".join(map(Path.read_text, root.glob("manifests/*.json"))), 600)
    slurm.run(f"scancel {job}")
    assert slurm.ended(job).startswith("CANCELLED")


def test_a_job_with_precedence_takes_the_nodes_and_gives_them_back(
    slurm: Slurm, undisturbed: dict[str, bytes]
) -> None:
    root = slurm.shared / "preempted"
    job = slurm.submit(f"--nodes=3 {JOB} {CAMPAIGN} --results /shared/preempted")
    wait_until(lambda: any(root.glob("checkpoints/*/*/index.json")), 300)
    slurm.run("sbatch --partition=urgent --nodes=3 --exclusive --wrap 'sleep 1'")
    wait_until(lambda: slurm.restarts(job) == 1, 300)
    slurm.run(f"scontrol update JobId={job} StartTime=now")
    assert slurm.ended(job) == "COMPLETED 0:0", slurm.log(job)
    assert data_files(root) == undisturbed


def test_scancel_with_int_leaves_checkpoints_for_good(slurm: Slurm, undisturbed: dict[str, bytes]) -> None:
    root = slurm.shared / "interrupted"
    submission = f"--nodes=2 {JOB} {CAMPAIGN} --results /shared/interrupted"
    job = slurm.submit(submission)
    wait_until(lambda: any(root.glob("checkpoints/*/*/index.json")), 300)
    slurm.run(f"scancel --batch --signal=INT {job}")
    assert slurm.ended(job) == "FAILED 130:0"
    stopped = rows(root, Table.ATTEMPTS)
    assert "stopped" in {row["outcome"] for row in stopped}
    assert all(row["host"] for row in stopped), "a run that was only queued has no attempt"
    again = slurm.submit(submission)
    assert slurm.ended(again) == "COMPLETED 0:0", slurm.log(again)
    assert data_files(root) == undisturbed


def test_a_plain_scancel_ends_the_job_and_the_same_command_resumes(
    slurm: Slurm, undisturbed: dict[str, bytes]
) -> None:
    root = slurm.shared / "cancelled"
    submission = f"--nodes=2 {JOB} {CAMPAIGN} --results /shared/cancelled"
    job = slurm.submit(submission)
    wait_until(lambda: any(root.glob("checkpoints/*/*/index.json")), 300)
    slurm.run(f"scancel {job}")
    assert slurm.ended(job).startswith("CANCELLED")
    wait_until(
        lambda: not any("raylet" in node.run("ps ax -o args", shown=False) for node in slurm.nodes), 120
    )
    again = slurm.submit(submission)
    assert slurm.ended(again) == "COMPLETED 0:0", slurm.log(again)
    assert data_files(root) == undisturbed

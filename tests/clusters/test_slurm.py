"""`docs/slurm.sh` on a real Slurm: one to three nodes, time limits, precedence, `scancel`."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from bed import VENV, Bed, bed_of, wait_until
from checkout import CAMPAIGN, tables
from slurm import Slurm, missing_daemons
from small_runs import rows

from tma_ray.results import Table

pytestmark = pytest.mark.skipif(missing_daemons() is not None, reason=str(missing_daemons()))
JOB = "--cpus-per-task=2 --mem=6G --time=30 docs/slurm.sh"

LONG = CAMPAIGN.replace("--steps 20000", "--steps 60000")
"""Four runs of which one at a time takes longer than Slurm needs to notice a limit, one minute."""


@pytest.fixture(scope="module")
def bed() -> Iterator[Bed]:
    with bed_of("one", "two", "three") as bed:
        yield bed


@pytest.fixture(scope="module")
def slurm(bed: Bed, wheel: Path) -> Slurm:
    return Slurm(bed, wheel)


@pytest.fixture(scope="module")
def undisturbed(slurm: Slurm) -> dict[str, str]:
    """Tables of `CAMPAIGN` as a single machine makes them."""
    slurm.run(f"{VENV}/bin/python {CAMPAIGN} --local --results /shared/undisturbed")
    return tables(slurm.shared / "undisturbed")


@pytest.fixture(scope="module")
def undisturbed_long(slurm: Slurm) -> dict[str, str]:
    """Tables of `LONG` as a single machine makes them."""
    slurm.run(f"{VENV}/bin/python {LONG} --local --results /shared/undisturbed-long")
    return tables(slurm.shared / "undisturbed-long")


@pytest.mark.parametrize("nodes", [1, 2, 3])
def test_a_campaign_trains_on_all_nodes(slurm: Slurm, undisturbed: dict[str, str], nodes: int) -> None:
    job = slurm.submit(f"--nodes={nodes} {JOB} {CAMPAIGN} --results /shared/on-{nodes}")
    assert slurm.ended(job) == "COMPLETED 0:0", slurm.log(job)
    root = slurm.shared / f"on-{nodes}"
    assert tables(root) == undisturbed
    assert "4/4 runs done" in slurm.run(f"{VENV}/bin/tma-ray status /shared/on-{nodes}")
    assert (len({row["host"] for row in rows(root, Table.ATTEMPTS)}) > 1) == (nodes > 1)
    for node in slurm.nodes:
        assert "raylet" not in node.run("ps ax -o args; ls /tmp/ray-* 2>/dev/null", code=None, shown=False)


def test_without_a_virtual_environment_the_job_says_how_one_is_named(slurm: Slurm) -> None:
    job = slurm.submit("--nodes=1 --chdir=/shared --cpus-per-task=1 --mem=1G docs/slurm.sh none.py")
    assert slurm.ended(job) == "FAILED 2:0"
    assert "TMA_RAY_VENV" in (slurm.shared / f"tma-ray-{job}.log").read_text()


def test_a_job_is_queued_again_until_it_is_done(slurm: Slurm, undisturbed_long: dict[str, str]) -> None:
    """The first life ends at its limit, set once there are checkpoints; the second while it waits."""
    root = slurm.shared / "limit"
    one_run = JOB.replace("--cpus-per-task=2", "--cpus-per-task=1")
    job = slurm.submit(f"--nodes=1 {one_run} {LONG} --results /shared/limit")
    wait_until(lambda: any(root.glob("checkpoints/*/*/index.json")), 300)
    slurm.limit(job, slurm.minutes(job) + 3)
    wait_until(lambda: slurm.state(job).startswith("PENDING"), 240)
    assert "stopped" in {row["outcome"] for row in rows(root, Table.ATTEMPTS)}
    slurm.limit(job, 30)
    slurm.run(f"scontrol update JobId={job} StartTime=now")
    wait_until(lambda: slurm.log(job).count("Ray runtime started") == 2, 240)
    # As --signal=B:TERM@120 has it sent to the batch shell before the limit.
    slurm.run(f"scancel --batch --signal=TERM {job}")
    wait_until(lambda: slurm.state(job).startswith("PENDING"), 120)
    slurm.run(f"scontrol update JobId={job} StartTime=now")
    assert slurm.ended(job) == "COMPLETED 0:0", slurm.log(job)
    assert slurm.restarts(job) == 2
    assert tables(root) == undisturbed_long
    outcomes = [row["outcome"] for row in rows(root, Table.ATTEMPTS)]
    assert (outcomes.count("done"), set(outcomes)) == (4, {"stopped", "done"})


def test_a_job_with_precedence_takes_the_nodes_and_gives_them_back(slurm, undisturbed_long):
    root = slurm.shared / "preempted"
    job = slurm.submit(f"--nodes=3 {JOB} {LONG} --results /shared/preempted")
    wait_until(lambda: any(root.glob("checkpoints/*/*/index.json")), 300)
    slurm.run("sbatch --partition=urgent --nodes=3 --exclusive --wrap 'sleep 1'")
    wait_until(lambda: slurm.restarts(job) == 1, 300)
    slurm.run(f"scontrol update JobId={job} StartTime=now")
    assert slurm.ended(job) == "COMPLETED 0:0", slurm.log(job)
    assert tables(root) == undisturbed_long
    assert len(rows(root, Table.ATTEMPTS)) > 4, "no run was interrupted"


def test_scancel_with_int_leaves_checkpoints_for_good(slurm: Slurm, undisturbed: dict[str, str]) -> None:
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
    assert tables(root) == undisturbed
    assert len(rows(root, Table.ATTEMPTS)) > 4, "no run was interrupted"


def test_scancel_ends_a_job_that_its_command_resumes(slurm: Slurm, undisturbed: dict[str, str]) -> None:
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
    assert tables(root) == undisturbed
    assert len(rows(root, Table.ATTEMPTS)) > 4, "no run was interrupted"

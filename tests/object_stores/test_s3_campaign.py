"""A campaign on a real Ray whose workers write into a bucket."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from small_runs import SCHEDULE, STUDENTS, data_files

from tma_ray.campaign import Campaign
from tma_ray.results import Committer, Store
from tma_ray.runs import Cell, run_locally

HERE = Path(__file__).parent
HELPERS = [str(HERE), str(HERE.parent / "runs"), str(HERE.parent / "campaign")]
CELL = Cell("corridor:Corridor", "original", "", "ppo", student_hyperparameters=STUDENTS["ppo"])
CELLS = tuple(replace(CELL, teacher=teacher) for teacher in ("random", "riac"))
CAMPAIGN = Campaign("bucket", CELLS, (0,), SCHEDULE)


def execute(root: str) -> subprocess.CompletedProcess[str]:
    """Execute the campaign in a process of its own, whose Ray has its environment."""
    path = os.pathsep.join([*HELPERS, os.environ.get("PYTHONPATH", "")])
    options = ("--memory-per-run", "0.5", "--checkpoint-seconds", "1")
    command = [sys.executable, __file__, "--results", root, *options]
    return subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True)


@pytest.mark.slow
def test_workers_write_into_a_bucket_what_one_process_writes_on_a_disk(s3_root: str, tmp_path: Path) -> None:
    ended = execute(s3_root)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    for spec in CAMPAIGN.plan().runs:
        run_locally(spec, Committer.open(tmp_path))
    assert len(data_files(tmp_path)) == 10
    assert data_files(s3_root) == data_files(tmp_path)
    assert not Store.open(s3_root).exists("lease.json")


if __name__ == "__main__":
    CAMPAIGN.main()

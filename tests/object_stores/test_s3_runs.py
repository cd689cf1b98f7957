"""Whole runs in a bucket: the tables of a run on a disk, bit for bit, whatever happens on the way."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier

import pytest
from s3_proxy import Proxy
from small_runs import SCHEDULE, STUDENTS, data_files, run, short_run

from analysis.baselines import find_baseline
from analysis.tracking.event_folder import EventFolder
from analysis.trials.design import make_design, released_runs
from tma_ray.campaign import Campaign
from tma_ray.cli.trial import _Trial
from tma_ray.results import CHECKPOINTS, Committer, Lease, Results, RootInUseError, Store, Table, create_root
from tma_ray.results.layout import LEASE_FILE
from tma_ray.results.storage import bucket
from tma_ray.runs import Cell, RunSpec, run_locally

FORTY = 40
EXPIRED = json.dumps({"holder": "dead", "token": "old", "renewed_at": 0.0, "process": None}).encode()


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunSpec, dict[str, bytes]]:
    """A short run, and the files that it gives on a disk."""
    return short_run(tmp_path_factory.mktemp("short"))


@pytest.mark.slow
def test_an_interrupted_run(s3_root: str, short: tuple[RunSpec, dict[str, bytes]], tmp_path: Path) -> None:
    spec, expected = short
    assert run(spec, s3_root, stop_after=7) == "stopped"
    assert run(spec, s3_root, stop_after=9) == "stopped"
    seen = Results.open(s3_root).table(Table.EPISODES).to_pydict()
    assert seen["episode"] == list(range(16))
    assert EventFolder(s3_root, tmp_path).update() == 1
    assert run(spec, s3_root) == "done"
    assert len(expected) == 5
    assert data_files(s3_root) == expected
    store = Store.open(s3_root)
    assert store.files(CHECKPOINTS) == store.files("staging") == store.files("tmp") == ()
    assert [path.split("/")[-1] for path in store.files("policies")].count("policy.safetensors") == 1


@pytest.mark.slow
def test_runs_outlast_throttling(s3_root: str, short: tuple[RunSpec, dict[str, bytes]], proxy: Proxy) -> None:
    spec, expected = short
    refused = set()

    def once_in_a_while(method: str, path: str) -> bool:
        place = len(proxy.seen)
        return place % 13 == 0 and not refused.add(place)

    proxy.refuse = once_in_a_while
    assert run(spec, s3_root) == "done"
    requests = len(proxy.seen) - len(refused)
    assert len(refused) > 5
    assert data_files(s3_root) == expected
    assert requests < 150, proxy.kinds()


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["checkpoints/", "manifests/"])
def test_an_outage_ends_the_attempt_and_the_next_one_continues(s3_root, short, proxy, monkeypatch, stage):
    spec, expected = short
    monkeypatch.setattr(bucket, "ATTEMPTS", 2)
    assert run(spec, s3_root, stop_after=5) == "stopped"
    proxy.refuse = lambda method, path: method == "PUT" and stage in path
    with pytest.raises(ConnectionError, match=stage):
        run(spec, s3_root, stop_after=5)
    proxy.refuse = lambda method, path: False
    seen = Results.open(s3_root).table(Table.EPISODES).to_pydict()
    assert seen["episode"] == list(range(5))
    assert run(spec, s3_root) == "done"
    assert data_files(s3_root) == expected


@pytest.mark.parametrize("left", [None, EXPIRED, b"{"], ids=["nothing", "an expired lease", "a damaged one"])
def test_exactly_one_of_forty_gets_the_lease_of_a_bucket(s3_root: str, left: bytes | None) -> None:
    store, barrier = Store.open(s3_root), Barrier(FORTY)
    if left is not None:
        store.write_bytes(LEASE_FILE, left)

    def ask(number: int) -> bool:
        lease = Lease(Store.open(s3_root), f"campaign {number}")
        barrier.wait(60)
        try:
            lease.acquire()
        except RootInUseError:
            return False
        lease.renew()
        return True

    with ThreadPoolExecutor(FORTY) as threads:
        assert sum(threads.map(ask, range(FORTY))) == 1


def test_the_page_of_a_trial_lies_in_the_bucket(s3_root: str) -> None:
    store, baseline = Store.open(s3_root), find_baseline("simulated-1")
    create_root(store)
    frames = baseline.frames()
    design = make_design("sobol", baseline, frames, cells=["original"])
    assert not _Trial(store, design, released_runs(frames), frames).judge()
    assert store.files("trial") == ("trial/index.html",)
    assert b"No look is complete yet" in store.read_bytes("trial/index.html")


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

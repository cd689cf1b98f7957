"""Processes that are killed while they upload leave whole objects, and manifests with all their parts."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tma_ray.results import Committer, Results, RunWriter, Store, Table

HELPERS = Path(__file__).parents[1] / "results"

PUBLISHER = f"""
import sys
sys.path.insert(0, {str(HELPERS)!r})
from itertools import count
import numpy as np
from results_examples import make_record
from tma_ray.results import Committer, RunWriter, Store, Table

store, run_id = Store.open(sys.argv[1]), sys.argv[2]
committer, record = Committer(store), make_record(run_id)
writer = RunWriter(store, run_id, committer.start(record))
for step in count():
    writer.add(Table.EVALUATIONS, [
        dict(step=step, test_set="grid", task_index=i, task=[0.0, 1.0], episodic_return=i / 3, length=9)
        for i in range(20)
    ])
    committer.publish(record, 0, writer.flush())
    print(step, flush=True)
"""

REPLACER = """
import sys
from itertools import count
from tma_ray.results import Store

store = Store.open(sys.argv[1])
for number in count():
    store.write_bytes("checkpoint", bytes([number % 256]) * 25_000_000)  # three parts of one upload
    print(number, flush=True)
"""


def kill_midway(script: str, arguments: list[str], delay: float, look: Callable[[], object]) -> int:
    """Kill the script `delay` seconds after it first said a number; return the last one that it said."""
    command = [sys.executable, "-c", script, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        said = int(process.stdout.readline())
        look()
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        return max([said, *(int(line) for line in process.stdout if line.endswith("\n"))])


@pytest.mark.slow
def test_publications_killed_midway_lose_and_double_nothing(s3_root: str) -> None:
    chance = random.Random(0)

    def look(run_id: str) -> list[int]:
        results = Results.open(s3_root)
        rows = results.table(Table.EVALUATIONS, [run_id]).to_pydict()
        assert results.problems == []
        steps = len(rows["step"]) // 20
        assert rows["step"] == [step for step in range(steps) for _ in range(20)]
        assert rows["task_index"] == list(range(20)) * steps
        return list(rows["step"])

    for run_id in (f"run-{number}" for number in range(12)):
        said = kill_midway(
            PUBLISHER, [s3_root, run_id], chance.uniform(0.0, 0.1), lambda run_id=run_id: look(run_id)
        )
        steps = look(run_id)
        assert steps[-1] >= said
    committer = Committer.open(s3_root)
    published = committer.manifest(run_id)
    assert published is not None
    attempt = committer.start(published.run)
    successor = RunWriter(committer.store, run_id, attempt, published.files)
    committer.finish(published.run, attempt, successor.finish())
    assert look(run_id) == steps


@pytest.mark.slow
def test_a_large_object_whose_replacement_is_killed_keeps_its_old_content(s3_root: str) -> None:
    chance, store, cut = random.Random(1), Store.open(s3_root), 0

    def look() -> int:
        content = store.read_bytes("checkpoint")
        assert content == content[:1] * 25_000_000
        return content[0]

    for _ in range(6):
        said = kill_midway(REPLACER, [s3_root], chance.uniform(0.0, 0.3), look)
        cut += look() == said
    assert cut > 0, "some uploads were cut off"

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

store = Store.open(sys.argv[1])
committer, record = Committer(store), make_record("run-1")
published = committer.manifest("run-1")
attempt = committer.start(record)
writer = RunWriter(store, "run-1", attempt, published.files if published else ())
first = len(published.files) if published else 0
for step in count(first):
    writer.add(Table.EVALUATIONS, [
        dict(step=step, test_set="grid", task_index=i, task=[0.0, 1.0], episodic_return=i / 3, length=9)
        for i in range(20)
    ])
    committer.publish(record, attempt, writer.flush())
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


def kill_midway(script: str, root: str, after: int, delay: float, look: Callable[[], None]) -> int:
    """Kills the script `delay` seconds after it said `after` lines; returns the last number it said."""
    with subprocess.Popen([sys.executable, "-c", script, root], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for _ in range(after):
            said = int(process.stdout.readline())
            look()
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        return max([said, *(int(line) for line in process.stdout if line.endswith("\n"))])


@pytest.mark.slow
def test_publications_killed_midway_lose_and_double_nothing(s3_root: str) -> None:
    chance = random.Random(0)

    def look() -> list[int]:
        results = Results.open(s3_root)
        rows = results.table(Table.EVALUATIONS).to_pydict()
        assert results.problems == []
        steps = len(rows["step"]) // 20
        assert rows["step"] == [step for step in range(steps) for _ in range(20)]
        assert rows["task_index"] == list(range(20)) * steps
        return rows["step"]

    for _ in range(20):
        said = kill_midway(PUBLISHER, s3_root, chance.randint(1, 3), chance.uniform(0.0, 0.1), look)
        assert look()[-1] >= said
    steps = look()
    committer = Committer.open(s3_root)
    published = committer.manifest("run-1")
    assert published is not None
    assert published.attempt == 19
    committer.start(published.run)
    successor = RunWriter(committer.store, "run-1", 20, published.files)
    committer.finish(published.run, 20, successor.finish())
    assert look() == steps


@pytest.mark.slow
def test_a_large_object_whose_replacement_is_killed_keeps_its_old_content(s3_root: str) -> None:
    chance, store, cut = random.Random(1), Store.open(s3_root), 0

    def look() -> int:
        content = store.read_bytes("checkpoint")
        assert content == content[:1] * 25_000_000
        return content[0]

    for _ in range(10):
        said = kill_midway(REPLACER, s3_root, 1, chance.uniform(0.0, 0.3), look)
        cut += look() == said
    assert cut > 0, "some uploads were cut off"

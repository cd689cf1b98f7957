"""Several processes that ask for the lease of one root at the same instant: exactly one gets it."""

from __future__ import annotations

import errno
import fcntl
import json
import multiprocessing
from collections import Counter
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

import pytest

from tma_ray.results import Lease, RootInUseError, Store
from tma_ray.results.layout import LEASE_FILE

PROCESSES, ROUNDS = 3, 15

EXPIRED = {"holder": "dead", "token": "old", "renewed_at": 0.0, "process": None}

LEFT_BEHIND = {"nothing": None, "an expired lease": json.dumps(EXPIRED), "a damaged lease": "{"}


def ask(place: str, barrier: Barrier, answers: Any) -> None:
    """Ask for the lease of each root in `place` as soon as all processes are ready; keep what it gets."""
    for root in sorted(Path(place).iterdir()):
        lease = Lease(Store.open(root), f"process {multiprocessing.current_process().name}")
        barrier.wait(60)
        try:
            lease.acquire()
            lease.renew()
        except RootInUseError:
            answers.put((root.name, "refused"))
        else:
            answers.put((root.name, "got it"))


@pytest.mark.parametrize("left", LEFT_BEHIND)
def test_exactly_one_of_several_processes_gets_it(tmp_path: Path, left: str) -> None:
    assert_one_gets_it(tmp_path, LEFT_BEHIND[left])


def test_a_new_lease_needs_no_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    assert_one_gets_it(tmp_path, None)


def assert_one_gets_it(tmp_path: Path, content: str | None) -> None:
    for number in range(ROUNDS):
        root = tmp_path / f"root-{number:02d}"
        root.mkdir()
        if content is not None:
            (root / LEASE_FILE).write_text(content)
    context = multiprocessing.get_context("fork")
    barrier, answers = context.Barrier(PROCESSES), context.Queue()
    processes = [
        context.Process(target=ask, args=(str(tmp_path), barrier, answers)) for _ in range(PROCESSES)
    ]
    for process in processes:
        process.start()
    found = Counter(answers.get(timeout=60) for _ in range(PROCESSES * ROUNDS))
    for process in processes:
        process.join(60)
        assert process.exitcode == 0
    assert {root: found[root.name, "got it"] for root in tmp_path.iterdir()} == dict.fromkeys(
        tmp_path.iterdir(), 1
    )

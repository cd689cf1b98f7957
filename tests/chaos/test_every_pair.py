"""Every student with every teacher, killed at any instant, again and again."""

import multiprocessing
import random
import time
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest
from faults import Fault
from small_runs import STUDENTS, data_files, run, small_spec

from tma_ray.results import Committer, RunStatus
from tma_ray.runs import Placement, RunSpec
from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers import TEACHERS, knows_enough

EVERY_EPISODE = Placement(checkpoint_seconds=0.0)

PRELOADED = [
    *("small_runs", "corridor", "stable_baselines3"),
    *("tma_ray.students.sac", "tma_ray.students.ppo"),
]
"""Imported once for all runs, of which each has a process of its own."""

MOST_KILLS = 6

PAIRED = [name for name in sorted(TEACHERS.names()) if knows_enough(TEACHERS.get(name), KnowledgeLevel.LOW)]
"""The others need an easy task, which the corridor does not have."""


@pytest.fixture(scope="module")
def processes() -> ForkServerContext:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    return context


def play(spec: RunSpec, root: Path) -> None:
    run(spec, root, placement=EVERY_EPISODE)


def start(processes: ForkServerContext, spec: RunSpec, root: Path) -> BaseProcess:
    process = processes.Process(target=play, args=(spec, root))
    process.start()
    return process


def is_done(root: Path, spec: RunSpec) -> bool:
    manifest = Committer.open(root).manifest(spec.run_id)
    return manifest is not None and manifest.status is RunStatus.DONE


def kill_until_done(
    processes: ForkServerContext, spec: RunSpec, root: Path, seconds: float, chance: random.Random
) -> int:
    """Kill the run after up to `seconds`, and its successors; return how often it had to begin again."""
    for kills in range(MOST_KILLS):
        process = start(processes, spec, root)
        process.join(chance.uniform(0.02, seconds))
        process.kill()
        process.join()
        if is_done(root, spec):
            return kills
    process = start(processes, spec, root)
    process.join()
    assert process.exitcode == 0
    return MOST_KILLS


def disturb(processes: ForkServerContext, folder: Path, student: str, teacher: str, steps: int) -> Fault:
    spec = small_spec(folder, student, teacher, steps=steps)
    begin = time.monotonic()
    process = start(processes, spec, folder / "undisturbed")
    process.join()
    assert process.exitcode == 0
    seconds = time.monotonic() - begin
    chance = random.Random(teacher)
    for halvings in range(1, 5):  # what compiles at first is faster afterwards
        killed = folder / f"killed-{halvings}"
        kills = kill_until_done(processes, spec, killed, 0.5**halvings * seconds, chance)
        if kills >= 2:
            break
    assert kills >= 2, "it was too fast to be killed"
    expected, found = data_files(folder / "undisturbed"), data_files(killed)
    assert set(found) == set(expected)
    different = sum(found[path] != data for path, data in expected.items())
    return Fault(f"run killed: {student}, {teacher}", kills, 0, different)


@pytest.mark.chaos
@pytest.mark.parametrize("student", STUDENTS)
@pytest.mark.parametrize("teacher", PAIRED)
def test_every_pair_killed_at_any_instant(processes, tmp_path, check, student, teacher):
    check(disturb(processes, tmp_path, student, teacher, 800))

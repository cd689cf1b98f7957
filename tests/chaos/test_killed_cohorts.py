"""Cohorts whose learner, players, driver and node are killed, or whose learner is stopped."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator

import pytest
from faults import Fault, Site, undisturbed_files, wait_for
from nodes import Nodes
from saboteur import HOLD
from test_processes import check

pytestmark = pytest.mark.chaos

WIDTH = 4

PATIENCE = "10"
"""Time that a learner may not answer, s; on a busy machine it is long in coming."""

CORES = 2
"""Of a node with room for a learner and its players."""


@pytest.fixture(scope="module")
def undisturbed() -> dict[str, bytes]:
    """The data files of the runs, each alone in its cohort."""
    return undisturbed_files(width=WIDTH)


@pytest.fixture
def roomy(nodes: Nodes) -> Iterator[int]:
    """The number of a node with room for a cohort, which no other has."""
    yield nodes.add(CORES)
    for number in nodes.living[-1:]:
        nodes.kill(number)


def trained(site: Site, runs: int = 2) -> None:
    """Wait until every run has a checkpoint."""
    wait_for(lambda: len({path.parts[-3] for path in site.checkpoints()}) == runs)


def start(site: Site) -> tuple[list[float], subprocess.Popen[bytes]]:
    site.ask(HOLD)
    return [], site.start("--cohort", str(WIDTH), "--unreachable-seconds", PATIENCE)


@pytest.mark.parametrize(
    ("victim", "number", "lost"),
    [
        ("LearnerActor", signal.SIGKILL, 2),
        ("LearnerActor", signal.SIGSTOP, 2),
        ("SeedActor", signal.SIGKILL, 1),
    ],
)
def test_a_process_of_a_cohort_killed_or_stopped(
    clustered: Site,
    nodes: Nodes,
    roomy: int,
    undisturbed: dict[str, bytes],
    faults: list[Fault],
    victim: str,
    number: signal.Signals,
    lost: int,
) -> None:
    """The learner costs all its runs some steps, also if it hangs; a player its own run only."""
    times, driver = start(clustered)
    trained(clustered)
    os.kill(nodes.workers(victim)[0], number)
    times.append(time.time())
    wait_for(lambda: clustered.taken_up(1))
    clustered.withdraw(HOLD)
    clustered.finish(driver)
    assert clustered.outcomes() == ["done", "done", *["lost"] * lost]
    check(clustered.compare(f"cohort: {victim} {number.name}", 1, undisturbed, times), faults)


def test_learners_of_two_nodes_of_which_one_is_killed(
    clustered: Site, nodes: Nodes, roomy: int, faults: list[Fault]
) -> None:
    """Each node has a learner and the players beside it; the runs of the lost one go on at the other."""
    own, times = (roomy, nodes.add(CORES)), []
    clustered.ask(HOLD)
    driver = clustered.start("--cohort", "2", "--seeds", "2")
    trained(clustered, runs=4)
    for kind, count in (("LearnerActor", 1), ("SeedActor", 2)):
        processes = set(nodes.workers(kind))
        assert [len(processes & nodes.processes(node)) for node in own] == [count, count]
    nodes.kill(own[1])
    times.append(time.time())
    clustered.withdraw(HOLD)
    clustered.finish(driver)
    assert clustered.outcomes() == [*["done"] * 4, *["lost"] * 2]
    expected = undisturbed_files(width=2, seeds=2)
    check(clustered.compare("cohort: one of two nodes killed", 1, expected, times), faults)


def test_the_node_of_a_cohort_killed(
    clustered: Site, nodes: Nodes, roomy: int, undisturbed: dict[str, bytes], faults: list[Fault]
) -> None:
    times, driver = start(clustered)
    trained(clustered)
    nodes.kill(roomy)
    times.append(time.time())
    nodes.add(CORES)
    wait_for(lambda: clustered.taken_up(1))
    clustered.withdraw(HOLD)
    clustered.finish(driver)
    assert "lost" in clustered.outcomes()
    check(clustered.compare("cohort: node killed", 1, undisturbed, times), faults)


def test_the_driver_of_a_cohort_killed(
    clustered: Site, nodes: Nodes, roomy: int, undisturbed: dict[str, bytes], faults: list[Fault]
) -> None:
    """Its learner ends with it, and the same command continues in another one."""
    times, driver = start(clustered)
    trained(clustered)
    driver.kill()
    driver.wait()
    times.append(time.time())
    wait_for(lambda: not nodes.workers("LearnerActor"))
    clustered.withdraw(HOLD)
    clustered.finish(clustered.start("--cohort", str(WIDTH)))
    check(clustered.compare("cohort: driver killed", 1, undisturbed, times), faults)

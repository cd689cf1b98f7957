"""Cohorts whose learner, rollout workers, driver and node are killed, or whose learner is stopped."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator

import pytest
from faults import Check, Compare, Site, undisturbed_files, wait_for
from nodes import Nodes

pytestmark = pytest.mark.chaos
WIDTH = 4

PATIENCE = "10"
"""Time that a learner may not answer, s; on a busy machine it is long in coming."""

CORES = 2
"""Of a node with room for a learner and its rollout workers."""


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


def start(site: Site) -> subprocess.Popen[bytes]:
    """Start a held campaign, and wait until every run has a checkpoint."""
    driver = site.hold("--cohort", str(WIDTH), "--unreachable-seconds", PATIENCE)
    site.trained()
    return driver


@pytest.mark.parametrize(
    ("victim", "number", "lost"),
    [
        ("LearnerActor", signal.SIGKILL, 2),
        ("LearnerActor", signal.SIGSTOP, 2),
        ("SeedActor", signal.SIGKILL, 1),
    ],
)
def test_a_process_of_a_cohort_killed_or_stopped(clustered, nodes, roomy, compare, victim, number, lost):
    """The learner costs all its runs some steps, also if it hangs; a rollout worker its own run only."""
    driver = start(clustered)
    os.kill(nodes.workers(victim)[0], number)
    fault = time.time()
    wait_for(lambda: clustered.taken_up(1))
    clustered.go_on(driver)
    assert clustered.outcomes() == ["done", "done", *["lost"] * lost]
    compare(f"cohort: {victim} {number.name}", [fault])


def test_one_of_two_learners_nodes_is_killed(clustered: Site, nodes: Nodes, roomy: int, check: Check) -> None:
    """Each node has a learner and the rollout workers beside it; the lost runs go on at the other."""
    own = (roomy, nodes.add(CORES))
    driver = clustered.hold("--cohort", "2", "--seeds", "2")
    clustered.trained(runs=4)
    for kind, count in (("LearnerActor", 1), ("SeedActor", 2)):
        processes = set(nodes.workers(kind))
        assert [len(processes & nodes.processes(node)) for node in own] == [count, count]
    nodes.kill(own[1])
    fault = time.time()
    clustered.go_on(driver)
    assert clustered.outcomes() == [*["done"] * 4, *["lost"] * 2]
    expected = undisturbed_files(width=2, seeds=2)
    check(clustered.compare("cohort: one of two nodes killed", 1, expected, [fault]))


def test_the_node_of_a_cohort_killed(clustered: Site, nodes: Nodes, roomy: int, compare: Compare) -> None:
    driver = start(clustered)
    nodes.kill(roomy)
    fault = time.time()
    nodes.add(CORES)
    wait_for(lambda: clustered.taken_up(1))
    clustered.go_on(driver)
    assert "lost" in clustered.outcomes()
    compare("cohort: node killed", [fault])


def test_the_driver_of_a_cohort_killed(clustered: Site, nodes: Nodes, roomy: int, compare: Compare) -> None:
    """Its learner ends with it, and the same command continues in another one."""
    driver = start(clustered)
    driver.kill()
    driver.wait()
    fault = time.time()
    wait_for(lambda: not nodes.workers("LearnerActor"))
    clustered.go_on(clustered.start("--cohort", str(WIDTH)))
    compare("cohort: driver killed", [fault])

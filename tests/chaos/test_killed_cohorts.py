"""Cohorts whose learner, players, driver and node are killed."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator

import pytest
from faults import Fault, Site, kill, undisturbed_files, wait_for
from nodes import Nodes
from saboteur import HOLD
from test_processes import check

pytestmark = pytest.mark.chaos

WIDTH = 4

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


def trained(site: Site) -> None:
    """Waits until every run has a checkpoint."""
    wait_for(lambda: len({path.parts[-3] for path in site.checkpoints()}) == 2)


def start(site: Site) -> tuple[list[float], subprocess.Popen[bytes]]:
    site.ask(HOLD)
    return [], site.start("--cohort", str(WIDTH))


@pytest.mark.parametrize(("victim", "lost"), [("LearnerActor", 2), ("SeedActor", 1)])
def test_a_process_of_a_cohort_killed(
    clustered: Site,
    nodes: Nodes,
    roomy: int,
    undisturbed: dict[str, bytes],
    faults: list[Fault],
    victim: str,
    lost: int,
) -> None:
    """The learner costs all its runs some steps, a player its own run only."""
    times, driver = start(clustered)
    trained(clustered)
    kill(nodes.workers(victim)[0])
    times.append(time.time())
    wait_for(lambda: clustered.taken_up(1))
    clustered.withdraw(HOLD)
    clustered.finish(driver)
    assert clustered.outcomes() == ["done", "done", *["lost"] * lost]
    check(clustered.compare(f"cohort: {victim} killed", 1, undisturbed, times), faults)


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

"""Nodes that die, freeze and come back with processes that were taken for lost."""

from __future__ import annotations

import time

import pytest
from faults import Fault, Site, wait_for
from nodes import Nodes
from saboteur import HOLD
from test_processes import check

pytestmark = pytest.mark.chaos


def trained_somewhere(site: Site, nodes: Nodes) -> int:
    """Wait until every run has a checkpoint; return a node that trains one."""
    wait_for(lambda: len({path.parts[-3] for path in site.checkpoints()}) == 2)
    seeds = set(nodes.workers("SeedActor"))
    return next(number for number in nodes.living if nodes.processes(number) & seeds)


def test_nodes_killed(
    clustered: Site, nodes: Nodes, undisturbed: dict[str, bytes], faults: list[Fault]
) -> None:
    clustered.ask(HOLD)
    driver, times = clustered.start(), []
    for _ in range(2):
        number, attempts = trained_somewhere(clustered, nodes), clustered.attempts()
        nodes.kill(number)
        times.append(time.time())
        nodes.add()
        wait_for(lambda attempts=attempts: clustered.attempts() - attempts)
    clustered.withdraw(HOLD)
    clustered.finish(driver)
    assert "lost" in clustered.outcomes()
    check(clustered.compare("node killed", 2, undisturbed, times), faults)


def test_a_raylet_killed_whose_workers_go_on(
    clustered: Site, nodes: Nodes, undisturbed: dict[str, bytes], faults: list[Fault]
) -> None:
    """For some seconds a run has two processes; the results are the successor's alone."""
    clustered.ask(HOLD)
    driver = clustered.start()
    nodes.kill_raylet(trained_somewhere(clustered, nodes))
    fault = time.time()
    nodes.add()
    wait_for(lambda: clustered.taken_up(1))
    clustered.withdraw(HOLD)
    clustered.finish(driver)
    assert "lost" in clustered.outcomes()
    check(clustered.compare("raylet killed, workers go on", 1, undisturbed, [fault]), faults)


def test_a_frozen_node_that_thaws_after_its_runs_were_given_away(
    clustered: Site, nodes: Nodes, undisturbed: dict[str, bytes], faults: list[Fault]
) -> None:
    clustered.ask(HOLD)
    driver = clustered.start()
    number = trained_somewhere(clustered, nodes)
    frozen = nodes.freeze(number)
    fault = time.time()
    nodes.add()
    try:
        wait_for(lambda: clustered.taken_up(1))
    finally:
        nodes.thaw(frozen)
    wait_for(lambda: nodes.ended(frozen))  # they find their successors and end
    clustered.withdraw(HOLD)
    clustered.finish(driver)
    nodes.kill(number)
    assert "lost" in clustered.outcomes()
    check(clustered.compare("node frozen, thawed later", 1, undisturbed, [fault]), faults)


def test_a_node_frozen_for_a_moment_costs_nothing(
    clustered: Site, nodes: Nodes, undisturbed: dict[str, bytes], faults: list[Fault]
) -> None:
    clustered.ask(HOLD)
    driver = clustered.start()
    frozen = nodes.freeze(trained_somewhere(clustered, nodes))
    time.sleep(1.5)
    nodes.thaw(frozen)
    clustered.withdraw(HOLD)
    clustered.finish(driver)
    assert clustered.outcomes() == ["done", "done"]
    check(clustered.compare("node frozen for 1.5 s", 1, undisturbed, []), faults)

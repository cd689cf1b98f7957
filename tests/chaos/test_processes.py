"""Processes that are killed at each place where it could hurt, nodes that freeze, and code that raises."""

from __future__ import annotations

import signal
import time

import pytest
from faults import Fault, Site, wait_for
from nodes import Nodes
from saboteur import HOLD

from tma_ray.results import Results, RunStatus

pytestmark = pytest.mark.chaos

WORKER_PLACES = (
    "kill-in-step",
    "kill-in-evaluation",
    "kill-in-parts",
    "kill-in-checkpoint",
    "kill-before-index",
    "kill-in-policy",
    "kill-teacher",
)
DRIVER_PLACES = (
    "kill-driver-before-run-row",
    "kill-driver-before-manifest",
    "kill-driver-between-moves",
    "kill-driver-before-attempt-row",
)


def check(fault: Fault, faults: list[Fault]) -> None:
    faults.append(fault)
    assert (fault.rows_lost, fault.bytes_different) == (0, 0)


def killed_workers(site: Site, places: tuple[str, ...]) -> list[float]:
    """Has workers killed at these places, one after the other; returns when."""
    times = []
    driver = site.start()
    for place in places:
        site.ask(place)
        times.append(wait_for(lambda place=place: not site.pending(place)))
    site.finish(driver)
    return times


def test_a_worker_killed_in_a_checkpoint_and_the_driver_in_a_publication(
    single: Site, undisturbed_short: dict[str, bytes], faults: list[Fault]
) -> None:
    single.ask("kill-in-checkpoint", "kill-driver-between-moves")
    single.finish(single.start(), -signal.SIGKILL)
    fault = time.time()
    assert not single.pending("kill-in-checkpoint", "kill-driver-between-moves")
    single.finish(single.start())
    assert "lost" in single.outcomes()
    check(single.compare("worker, then driver killed", 2, undisturbed_short, [fault]), faults)


@pytest.mark.parametrize("place", WORKER_PLACES)
def test_a_worker_killed(
    clustered: Site, undisturbed: dict[str, bytes], faults: list[Fault], place: str
) -> None:
    times = killed_workers(clustered, (place,))
    assert clustered.outcomes() == ["done", "done", "lost"]
    check(clustered.compare(f"worker: {place}", 1, undisturbed, times), faults)


def drivers_killed(site: Site, places: tuple[str, ...]) -> list[float]:
    """Has drivers killed at these places, one after the other; returns when, and finishes the campaign."""
    times = []
    for place in places:
        site.ask(place)
        site.finish(site.start(), -signal.SIGKILL)
        times.append(time.time())
        assert not site.pending(place)
    site.finish(site.start())
    return times


def test_drivers_killed_in_every_publication(
    clustered: Site, undisturbed: dict[str, bytes], faults: list[Fault]
) -> None:
    times = drivers_killed(clustered, DRIVER_PLACES)
    check(clustered.compare("driver killed at each place", len(times), undisturbed, times), faults)


def trained_somewhere(site: Site, nodes: Nodes) -> int:
    """Wait until every run has a checkpoint; return a node that trains one."""
    wait_for(lambda: len({path.parts[-3] for path in site.checkpoints()}) == 2)
    seeds = set(nodes.workers("SeedActor"))
    return next(number for number in nodes.living if nodes.processes(number) & seeds)


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


@pytest.mark.parametrize("part", ["teacher", "environment", "student"])
def test_a_part_that_raises(
    clustered: Site, undisturbed: dict[str, bytes], faults: list[Fault], part: str
) -> None:
    clustered.ask(f"raise-in-{part}")
    clustered.finish(clustered.start(), 1)
    runs = Results.open(clustered.root).runs()
    assert sorted(run.status for run in runs) == [RunStatus.DONE, RunStatus.FAILED]
    (failed,) = (run for run in runs if run.status is RunStatus.FAILED)
    assert "own mistake" in str(failed.error)
    assert "saboteur.py" in str(failed.error), "the traceback names the file"
    assert "\x1b" not in str(failed.error)
    assert clustered.outcomes() == ["done", "failed"], "it was not tried again"
    fault = time.time()
    clustered.finish(clustered.start())
    check(clustered.compare(f"{part} raises", 1, undisturbed, [fault]), faults)

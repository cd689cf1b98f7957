"""Processes that are killed at each place where it could hurt, frozen nodes, raising code, full storage."""

import signal
import time

import pytest
from faults import Compare, Site, wait_for
from nodes import Nodes
from saboteur import FULL_DISK, HOLD

from tma_ray.results import Results, RunStatus

pytestmark = pytest.mark.chaos

WORKER_PLACES = (
    *("kill-in-step", "kill-in-evaluation", "kill-in-parts", "kill-in-checkpoint", "kill-before-index"),
    *("kill-in-policy", "kill-teacher"),
)
DRIVER_PLACES = (
    *("kill-driver-before-run-row", "kill-driver-before-manifest", "kill-driver-between-moves"),
    "kill-driver-before-attempt-row",
)


def test_a_worker_killed_in_a_checkpoint_and_the_driver_in_a_publication(single, undisturbed_short, check):
    single.ask("kill-in-checkpoint", "kill-driver-between-moves")
    single.finish(single.start(), -signal.SIGKILL)
    fault = time.time()
    assert not single.pending("kill-in-checkpoint", "kill-driver-between-moves")
    single.finish(single.start())
    assert "lost" in single.outcomes()
    check(single.compare("worker, then driver killed", 2, undisturbed_short, [fault]))


@pytest.mark.parametrize("place", WORKER_PLACES)
def test_a_worker_killed(clustered: Site, compare: Compare, place: str) -> None:
    driver = clustered.start()
    clustered.ask(place)
    fault = wait_for(lambda: not clustered.pending(place))
    clustered.finish(driver)
    assert clustered.outcomes() == ["done", "done", "lost"]
    compare(f"worker: {place}", [fault])


def test_drivers_killed_in_every_publication(clustered: Site, compare: Compare) -> None:
    times = []
    for place in DRIVER_PLACES:
        clustered.ask(place)
        clustered.finish(clustered.start(), -signal.SIGKILL)
        times.append(time.time())
        assert not clustered.pending(place)
    clustered.finish(clustered.start())
    compare("driver killed at each place", times, injected=len(times))


def trained_somewhere(site: Site, nodes: Nodes) -> int:
    """Wait until every run has a checkpoint; return a node that trains one."""
    site.trained()
    seeds = set(nodes.workers("SeedActor"))
    return next(number for number in nodes.living if nodes.processes(number) & seeds)


def test_a_frozen_node_thaws_after_its_runs_left(clustered: Site, nodes: Nodes, compare: Compare) -> None:
    driver = clustered.hold()
    number = trained_somewhere(clustered, nodes)
    frozen = nodes.freeze(number)
    fault = time.time()
    nodes.add()
    try:
        wait_for(lambda: clustered.taken_up(1))
    finally:
        nodes.thaw(frozen)
    wait_for(lambda: nodes.ended(frozen))  # they find their successors and end
    clustered.go_on(driver)
    nodes.kill(number)
    assert "lost" in clustered.outcomes()
    compare("node frozen, thawed later", [fault])


def test_a_node_frozen_for_a_moment_costs_nothing(clustered: Site, nodes: Nodes, compare: Compare) -> None:
    driver = clustered.hold()
    frozen = nodes.freeze(trained_somewhere(clustered, nodes))
    time.sleep(1.5)
    nodes.thaw(frozen)
    clustered.go_on(driver)
    assert clustered.outcomes() == ["done", "done"]
    compare("node frozen for 1.5 s", [])


@pytest.mark.parametrize("part", ["teacher", "environment", "student"])
def test_a_part_that_raises(clustered: Site, compare: Compare, part: str) -> None:
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
    compare(f"{part} raises", [fault])


def test_no_space_left_for_a_while(clustered: Site, compare: Compare) -> None:
    driver = clustered.hold()
    wait_for(clustered.checkpoints)
    clustered.ask(FULL_DISK)
    clustered.withdraw(HOLD)
    time.sleep(12)  # an outage of that length
    assert driver.poll() is None
    clustered.withdraw(FULL_DISK)
    clustered.finish(driver)
    assert clustered.outcomes() == ["done", "done"]
    compare("no space left for 12 s", [])


def test_no_space_left_until_the_campaign_gives_up(clustered: Site, compare: Compare) -> None:
    driver = clustered.hold("--outage-seconds", "4")
    wait_for(clustered.checkpoints)
    clustered.ask(FULL_DISK)
    clustered.withdraw(HOLD)
    clustered.finish(driver, 1)
    said = (clustered.folder / "driver.txt").read_text()
    assert "free some space there" in said
    assert "Traceback" not in said
    assert "ray::" not in said, "Ray's own traceback"
    clustered.withdraw(FULL_DISK)
    fault = time.time()
    clustered.finish(clustered.start())
    compare("no space left, campaign ended", [fault])


def test_a_second_driver_on_the_same_root(clustered: Site, compare: Compare) -> None:
    driver = clustered.hold()
    wait_for(clustered.checkpoints)
    for _ in range(2):
        clustered.finish(clustered.start(), 2)
    assert "is in use by campaign 'chaos'" in (clustered.folder / "driver.txt").read_text()
    clustered.go_on(driver)
    assert clustered.outcomes() == ["done", "done"]
    compare("second driver on the root", [], injected=2)

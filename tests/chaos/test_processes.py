"""Processes that are killed: workers, teachers and drivers, at each place where it could hurt."""

from __future__ import annotations

import random
import signal
import time

import pytest
from faults import Fault, Site, kill, wait_for
from nodes import Nodes
from saboteur import HOLD

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


@pytest.mark.chaos
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


@pytest.mark.chaos
@pytest.mark.parametrize("place", WORKER_PLACES)
def test_a_worker_killed(
    clustered: Site, undisturbed: dict[str, bytes], faults: list[Fault], place: str
) -> None:
    times = killed_workers(clustered, (place,))
    assert clustered.outcomes() == ["done", "done", "lost"]
    check(clustered.compare(f"worker: {place}", 1, undisturbed, times), faults)


@pytest.mark.chaos
def test_workers_killed_from_outside_at_random(
    clustered: Site, nodes: Nodes, undisturbed: dict[str, bytes], faults: list[Fault]
) -> None:
    """Both kinds of actors, some of them while they start."""
    chance, times = random.Random(0), []
    clustered.ask(HOLD)
    driver = clustered.start()
    for kind in ("SeedActor", "TeacherActor", "SeedActor", "TeacherActor"):
        wait_for(lambda kind=kind: nodes.workers(kind))
        time.sleep(chance.uniform(0, 2))
        victims = nodes.workers(kind)
        if victims:
            kill(chance.choice(victims))
            times.append(time.time())
    clustered.withdraw(HOLD)
    clustered.finish(driver)
    check(clustered.compare("worker killed from outside", len(times), undisturbed, times), faults)


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


@pytest.mark.chaos
def test_drivers_killed_in_every_publication(
    clustered: Site, undisturbed: dict[str, bytes], faults: list[Fault]
) -> None:
    times = drivers_killed(clustered, DRIVER_PLACES)
    check(clustered.compare("driver killed at each place", len(times), undisturbed, times), faults)


@pytest.mark.chaos
def test_drivers_killed_while_their_runs_train(
    clustered: Site, undisturbed: dict[str, bytes], faults: list[Fault]
) -> None:
    times = []
    clustered.ask(HOLD)
    for count in range(3):
        driver = clustered.start()
        wait_for(lambda count=count: clustered.taken_up(count))
        driver.kill()
        driver.wait()
        times.append(time.time())
    clustered.withdraw(HOLD)
    clustered.finish(clustered.start())
    check(clustered.compare("driver killed in training", len(times), undisturbed, times), faults)

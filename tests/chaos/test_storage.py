"""Storage that is full or damaged, and a root that somebody else holds."""

from __future__ import annotations

import time

import pytest
from faults import Compare, Site, wait_for
from saboteur import FULL_DISK, HOLD

pytestmark = pytest.mark.chaos


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

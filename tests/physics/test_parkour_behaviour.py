"""In Parkour too, the bodies behave as the original release's, measured by the same protocols."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import parkour_behaviour as parkour
import pytest
from behaviour import gaits, zero_action

pytestmark = pytest.mark.reference

LAND_IN_ANOTHER_POSE = ("old_classic_bipedal", "climbing_chimpanzee")
"""Bodies that 100 steps without torque leave in another pose; docs/fidelity.md tells how."""


@pytest.fixture(scope="module")
def release() -> dict[str, Any]:
    if "TMA_REFERENCE" not in os.environ:
        pytest.skip("TMA_REFERENCE is not set: no measured behaviour to compare with")
    return parkour.reference(Path(os.environ["TMA_REFERENCE"]))


def of_body(release: dict[str, Any], protocol: str, name: str) -> dict[str, Any]:
    return release[protocol]["bodies"][f"parkour/{parkour.release_name(name)}"]


@pytest.mark.parametrize("name", [name for name in parkour.BODIES if name not in LAND_IN_ANOTHER_POSE])
def test_limp_bodies_come_to_lie_as_high(name: str, release) -> None:
    theirs = of_body(release, "zero_action_flat_ground_100_steps", name)
    ours = zero_action(name, 10, parkour.dry())
    expected = theirs["head_height_above_ground"]["mean"]
    assert ours["head_height_above_ground"].mean() == pytest.approx(expected, abs=0.2)
    if theirs["first_terminal_step"]:
        steps = theirs["first_terminal_step"]["mean"]
        assert ours["first_terminal_step"].mean() == pytest.approx(steps, abs=4)


@pytest.mark.parametrize("name", parkour.BODIES)
def test_random_actions_earn_as_much_and_last_as_long(name: str, release) -> None:
    theirs, ours = of_body(release, "random_actions_cap500", name), parkour.random_figures(name, 30)
    assert ours["episode_return"].mean() == pytest.approx(theirs["episode_return"]["mean"], abs=15)
    assert ours["length"].mean() == pytest.approx(theirs["length"]["mean"], rel=0.25)
    assert ours["fraction_terminated"].mean() == pytest.approx(
        theirs["fraction_terminated"]["mean"], abs=0.15
    )


@pytest.mark.parametrize("name", parkour.BODIES)
def test_random_gaits_are_as_fast(name: str, release) -> None:
    theirs = of_body(release, "random_open_loop_gaits", name)
    ours = gaits(name, 30, parkour.place_of(name))
    assert ours["best_1s_speed"].mean() == pytest.approx(theirs["best_1s_speed"]["mean"], abs=0.5)
    assert ours["length"].mean() == pytest.approx(theirs["length"]["mean"], rel=0.15)


@pytest.mark.parametrize("name", parkour.CLIMBERS)
def test_climbers_hang_as_low_and_fall_as_fast(name: str, release) -> None:
    theirs = release["climbers_100_steps"]["results"]
    falls, hangs = (theirs[f"{parkour.release_name(name)}/{how}"] for how in ("all_zero", "grip_only"))
    ours = parkour.hanging(name, 1.0)
    assert np.all(ours["still_attached_by_both_hands_after_100"] == 1)
    assert not np.any(ours["fraction_terminated"])
    expected = hangs["head_distance_below_ceiling"]["mean"]
    assert ours["head_distance_below_ceiling"].mean() == pytest.approx(expected, abs=0.1)
    steps = falls["first_terminal_step"]["mean"]
    assert parkour.hanging(name, 0.0)["first_terminal_step"].mean() == pytest.approx(steps, abs=2)


def test_the_fish_rises_as_slowly(release) -> None:
    ours, theirs = parkour.under_water(parkour.FISH_STEPS), release["fish"]
    after_100 = theirs["zero_action_under_water_100_steps"]
    later = theirs["zero_action_under_water_longer_single_run"]
    expected = [after_100["dy"]["mean"], *[run["dy"] for run in later]]
    assert ours["dy"] == pytest.approx(expected, abs=0.02)
    assert ours["vy"] == pytest.approx(
        [after_100["vy_at_end"]["mean"], *[run["vy"] for run in later]], abs=0.005
    )


@pytest.mark.parametrize("name", parkour.RELEASED)
def test_water_carries_and_brakes_as_much(name: str, release) -> None:
    theirs, ours = (
        release["release_in_open_water"]["results"][parkour.release_name(name)],
        parkour.released(name),
    )
    for figure, tolerance in (("dy", 0.15), ("vy", 0.25)):
        expected = [theirs[f"after_{steps}_steps"][figure]["mean"] for steps in parkour.RELEASE_STEPS]
        assert ours[figure] == pytest.approx(expected, abs=0.003 if name == "fish" else tolerance)

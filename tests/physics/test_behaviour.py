"""Bodies behave as the original release's in both environments, measured by the same protocols."""

import behaviour
import numpy as np
import parkour_behaviour as parkour
import pytest
from behaviour import gaits, measured, zero_action
from suite.bodies import bodies, body

OTHERS = [name for name in behaviour.WALKERS if name != behaviour.CLASSIC]


def test_zero_actions_end_in_the_same_pose() -> None:
    ours, theirs = behaviour.zero_action(), measured("zero_actions", "stump_tracks", behaviour.CLASSIC)
    for name in ("head_height_above_ground", "head_x_displacement", "first_terminal_step", "head_angle"):
        assert ours[name].mean() == pytest.approx(theirs[name].mean, rel=0.25), name


@pytest.mark.parametrize(
    ("task", "count"),
    [
        (behaviour.TASKS[0], 150),
        pytest.param(behaviour.TASKS[1], 400, marks=pytest.mark.slow),
        pytest.param(behaviour.TASKS[2], 150, marks=pytest.mark.slow),
    ],
)
def test_random_actions_fall_as_often_and_earn_as_much(task: tuple[float, float], count: int) -> None:
    """At a middling height few episodes are very long, so that it takes more of them."""
    ours, theirs = behaviour.episodes(task, count), behaviour.release_of_task(task)
    for name in ("fraction_terminated", "length", "episode_return"):
        assert ours[name].mean() == pytest.approx(theirs[name].mean, rel=0.25), name


@pytest.mark.parametrize("name", [body(name) for name in OTHERS if name != "old_classic_bipedal"])
def test_limp_bodies_come_to_lie_as_high(name: str) -> None:
    ours, theirs = behaviour.zero_action(name), measured("zero_actions", "stump_tracks", name)
    for figure, tolerance in (("head_height_above_ground", 0.12), ("head_x_displacement", 0.4)):
        assert ours[figure].mean() == pytest.approx(theirs[figure].mean, abs=tolerance), figure


@pytest.mark.slow
def test_the_old_bipedal_falls_forward_as_the_releases_does() -> None:
    name = "old_classic_bipedal"
    ours, theirs = behaviour.zero_action(name), measured("zero_actions", "stump_tracks", name)
    assert ours["head_x_displacement"].mean() > 0.5 * theirs["head_x_displacement"].mean > 0


@pytest.mark.parametrize("name", list(map(body, OTHERS)))
def test_random_actions_lead_other_bodies_as_far(name: str) -> None:
    ours = behaviour.episodes(behaviour.TASKS[0], 50, 500, name)
    theirs = measured("random_actions", "stump_tracks", name)
    fell = ours["fraction_terminated"].mean()
    assert fell == pytest.approx(theirs["fraction_terminated"].mean, abs=0.2)
    assert ours["episode_return"].mean() == pytest.approx(theirs["episode_return"].mean, rel=0.25)
    ratio = ours["length"].mean() / theirs["length"].mean
    assert 0.5 < ratio < 2.25, "docs/fidelity.md explains why the wheel lasts longer"


def test_the_spider_gives_way_as_soon_as_the_releases() -> None:
    ours = behaviour.episodes(behaviour.TASKS[0], 200, 500, "spider")
    theirs = measured("random_actions", "stump_tracks", "spider")
    assert ours["length"].mean() == pytest.approx(theirs["length"].mean, rel=0.25)
    assert ours["length"].std() == pytest.approx(theirs["length"].std, rel=0.25)


LAND_IN_ANOTHER_POSE = ("old_classic_bipedal", "climbing_chimpanzee")
"""Bodies that 100 steps without torque leave in another pose; docs/fidelity.md tells how."""


LIMP = [name for name in parkour.BODIES if name not in LAND_IN_ANOTHER_POSE]


@pytest.mark.parametrize("name", list(map(body, LIMP)))
def test_limp_bodies_come_to_lie_as_high_in_parkour(name: str) -> None:
    ours, theirs = zero_action(name, 10, parkour.dry()), measured("zero_actions", "parkour", name)
    expected = theirs["head_height_above_ground"].mean
    assert ours["head_height_above_ground"].mean() == pytest.approx(expected, abs=0.2)
    if "first_terminal_step" in theirs:
        steps = theirs["first_terminal_step"].mean
        assert ours["first_terminal_step"].mean() == pytest.approx(steps, abs=4)


@pytest.mark.parametrize("name", bodies())
def test_random_actions_earn_as_much_and_last_as_long(name: str) -> None:
    ours, theirs = parkour.random_actions(name, 30), measured("random_actions", "parkour", name)
    assert ours["episode_return"].mean() == pytest.approx(theirs["episode_return"].mean, abs=15)
    assert ours["length"].mean() == pytest.approx(theirs["length"].mean, rel=0.25)
    expected = theirs["fraction_terminated"].mean
    assert ours["fraction_terminated"].mean() == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize("name", bodies())
def test_random_gaits_are_as_fast(name: str) -> None:
    """As many gaits as the release was measured with: their speeds vary by more than their mean."""
    ours, theirs = gaits(name, 100, parkour.place_of(name)), measured("random_gaits", "parkour", name)
    assert ours["best_1s_speed"].mean() == pytest.approx(theirs["best_1s_speed"].mean, abs=0.5)
    assert ours["length"].mean() == pytest.approx(theirs["length"].mean, rel=0.15)


@pytest.mark.parametrize("name", parkour.CLIMBERS)
def test_climbers_hang_as_low_and_fall_as_fast(name: str) -> None:
    falls, hangs = (measured("hanging", "parkour", name, case) for case in ("no grip", "grip"))
    ours = parkour.hanging(name, 1.0)
    assert np.all(ours["still_attached_by_both_hands_after_100"] == 1)
    assert not np.any(ours["fraction_terminated"])
    expected = hangs["head_distance_below_ceiling"].mean
    assert ours["head_distance_below_ceiling"].mean() == pytest.approx(expected, abs=0.1)
    steps = falls["first_terminal_step"].mean
    assert parkour.hanging(name, 0.0)["first_terminal_step"].mean() == pytest.approx(steps, abs=2)


def courses(protocol: str, name: str, steps: tuple[int, ...]) -> dict[str, list[float]]:
    """Return the release's mean rise and speed of a body in water after each of `steps`."""
    cases = [measured(protocol, "parkour", name, f"after {count} steps") for count in steps]
    return {figure: [case[figure].mean for case in cases] for figure in ("rise", "speed")}


def test_the_fish_rises_as_slowly() -> None:
    ours = parkour.under_water(parkour.FISH_STEPS)
    theirs = courses("zero_actions_under_water", "fish", parkour.FISH_STEPS)
    assert ours["rise"] == pytest.approx(theirs["rise"], abs=0.02)
    assert ours["speed"] == pytest.approx(theirs["speed"], abs=0.005)


@pytest.mark.parametrize("name", parkour.RELEASED)
def test_water_carries_and_brakes_as_much(name: str) -> None:
    ours = parkour.released(name)
    theirs = courses("released_in_water", name, parkour.RELEASE_STEPS)
    for figure, tolerance in (("rise", 0.15), ("speed", 0.25)):
        assert ours[figure] == pytest.approx(theirs[figure], abs=0.003 if name == "fish" else tolerance)

"""In Stump Tracks the bodies behave as the original release's, measured by the same protocols."""

import behaviour
import pytest
from behaviour import measured
from suite.bodies import body

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

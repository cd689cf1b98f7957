"""The bodies behave as the original release's, measured by the same protocols."""

import os
from pathlib import Path
from typing import Any

import behaviour
import pytest

pytestmark = pytest.mark.reference

OTHERS = [name for name in behaviour.WALKERS if name != behaviour.CLASSIC]


@pytest.fixture(scope="module")
def folder() -> Path:
    if "TMA_REFERENCE" not in os.environ:
        pytest.skip("TMA_REFERENCE is not set: no measured behaviour to compare with")
    return Path(os.environ["TMA_REFERENCE"])


@pytest.fixture(scope="module")
def release(folder: Path) -> dict[str, dict[str, Any]]:
    return behaviour.reference(folder)


def test_zero_actions_end_in_the_same_pose(release) -> None:
    ours, theirs = behaviour.zero_action(), release["zero actions"]
    for name in ("head_height_above_ground", "head_x_displacement", "first_terminal_step", "head_angle"):
        assert ours[name].mean() == pytest.approx(theirs[name]["mean"], rel=0.25), name


@pytest.mark.parametrize(("task", "count"), zip(behaviour.TASKS, (150, 400, 150), strict=True))
def test_random_actions_fall_as_often_and_earn_as_much(
    task: tuple[float, float], count: int, release
) -> None:
    """At a middling height few episodes are very long, so that it takes more of them."""
    ours, theirs = behaviour.episodes(task, count), release[f"random actions, task {task}"]
    for name in ("fraction_ending_in_a_fall", "length", "episode_return"):
        assert ours[name].mean() == pytest.approx(theirs[name]["mean"], rel=0.25), name


@pytest.mark.parametrize("name", [name for name in OTHERS if name != "old_classic_bipedal"])
def test_limp_bodies_come_to_lie_as_high(name: str, folder: Path) -> None:
    ours, theirs = behaviour.zero_action(name), behaviour.reference_of(name, folder)["zero actions"]
    for figure, tolerance in (("head_height_above_ground", 0.12), ("head_x_displacement", 0.4)):
        assert ours[figure].mean() == pytest.approx(theirs[figure]["mean"], abs=tolerance), figure


def test_the_old_bipedal_falls_forward_as_the_releases_does(folder: Path) -> None:
    name = "old_classic_bipedal"
    ours, theirs = behaviour.zero_action(name), behaviour.reference_of(name, folder)["zero actions"]
    assert ours["head_x_displacement"].mean() > 0.5 * theirs["head_x_displacement"]["mean"] > 0


@pytest.mark.parametrize("name", OTHERS)
def test_random_actions_lead_other_bodies_as_far(name: str, folder: Path) -> None:
    ours = behaviour.episodes(behaviour.TASKS[0], 50, 500, name)
    theirs = behaviour.reference_of(name, folder)["random actions"]
    fell = ours["fraction_ending_in_a_fall"].mean()
    assert fell == pytest.approx(theirs["fraction_ending_in_a_fall"]["mean"], abs=0.2)
    assert ours["episode_return"].mean() == pytest.approx(theirs["episode_return"]["mean"], rel=0.25)
    assert (
        0.5 < ours["length"].mean() / theirs["length"]["mean"] < 2.25
    )  # docs/fidelity.md explains the latter

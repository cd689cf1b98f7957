"""The classic bipedal walker behaves as the original release's, measured by the same protocols."""

import os
from pathlib import Path
from typing import Any

import behaviour
import pytest

pytestmark = pytest.mark.reference


@pytest.fixture(scope="module")
def release() -> dict[str, dict[str, Any]]:
    folder = os.environ.get("TMA_REFERENCE")
    if folder is None:
        pytest.skip("TMA_REFERENCE is not set: no measured behaviour to compare with")
    return behaviour.reference(Path(folder))


def test_zero_actions_end_in_the_same_pose(release) -> None:
    ours, theirs = behaviour.zero_action(), release["zero actions"]
    for name in ("head_height_above_ground", "head_x_displacement", "first_terminal_step", "head_angle"):
        assert ours[name].mean() == pytest.approx(theirs[name]["mean"], rel=0.25), name


@pytest.mark.parametrize("task", behaviour.TASKS)
def test_random_actions_fall_as_often_and_earn_as_much(task: tuple[float, float], release) -> None:
    ours, theirs = behaviour.episodes(task, 400), release[f"random actions, task {task}"]
    for name in ("fraction_ending_in_a_fall", "length", "episode_return"):
        assert ours[name].mean() == pytest.approx(theirs[name]["mean"], rel=0.25), name

"""The examples keep what tma_ray's own parts promise; tests/campaign runs them on a cluster."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "examples"), str(ROOT / "tests" / "teachers")]

import experiment  # noqa: E402 - makes "staircase" known
from simulated_play import SPACES, play, started  # noqa: E402
from swing_up import SwingUp  # noqa: E402

from tma_ray.tasks import TaskSpace  # noqa: E402

TEACHERS = ("frontier_teacher:Frontier", "staircase")


@pytest.mark.parametrize("name", TEACHERS)
@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES.keys())
def test_a_teacher_is_seeded_stays_inside_and_is_probed_without_a_trace(name: str, space: TaskSpace) -> None:
    probed, quiet = started(name, space), started(name, space)
    for part in range(3):
        tasks = probed.probe(20)
        assert tasks.shape == (20, space.size)
        assert tasks.dtype == np.float32
        assert space.contains(tasks)
        np.testing.assert_array_equal(probed.probe(20), tasks)
        np.testing.assert_array_equal(play(probed, 60, 60 * part), play(quiet, 60, 60 * part))
    assert not np.array_equal(play(started(name, space, seed=1), 60), play(started(name, space), 60))


@pytest.mark.parametrize("name", TEACHERS)
def test_a_saved_teacher_continues_identically(name: str) -> None:
    teacher, resumed = (started(name, SPACES["stump_tracks"], seed) for seed in (0, 9))
    play(teacher, 70)
    resumed.load_state(pickle.loads(pickle.dumps(teacher.state())))
    np.testing.assert_array_equal(play(teacher, 70, 70), play(resumed, 70, 70))


def test_teachers_teach_what_they_say() -> None:
    space = SPACES["line"]  # returns fall from 300 to -100 from its lower to its upper end
    frontier = started("frontier_teacher:Frontier", space)
    play(frontier, 200)
    assert abs(np.median(space.normalise(frontier.probe(100))) - 0.5) < 0.15
    staircase = started("staircase", space)
    assert space.normalise(staircase.probe(100)).max() <= 0.2
    play(staircase, 1000)
    assert space.normalise(staircase.probe(100)).max() > 0.3


def test_the_pendulum_is_a_gymnasium_environment_that_builds_its_task() -> None:
    environment = SwingUp()
    check_env(environment, skip_render_check=True)
    _, info = environment.reset(seed=0, options={"task": [0.5, 1.25]})
    assert (environment.m, environment.l) == (0.5, 1.25)
    np.testing.assert_array_equal(info["task"], np.float32([0.5, 1.25]))
    ends = [environment.step(np.zeros(1, np.float32))[2:4] for _ in range(200)]
    assert ends == [(False, False)] * 199 + [(False, True)]
    with pytest.raises(ValueError, match="mass = 50"):
        environment.reset(options={"task": [50, 1]})


def test_the_experiment_is_planned() -> None:
    plan = experiment.CAMPAIGN.plan()
    assert len(plan.runs) == 4
    assert {part for spec in plan.runs for part in spec.plugins} == {"environment", "student", "teacher"}
    assert {spec.mastery_threshold for spec in plan.runs} == {SwingUp.mastery_return}

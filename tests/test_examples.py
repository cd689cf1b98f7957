"""The examples keep what tma_ray's own parts promise; tests/campaign runs them on a cluster."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from frontier_teacher import Frontier
from gymnasium.utils.env_checker import check_env
from swing_up import SwingUp

from tma_ray.testing import TeacherConformance


@pytest.fixture(scope="module")
def experiment() -> ModuleType:
    """The experiment in one script, whose import makes its teacher's name known."""
    return importlib.import_module("experiment")


class TestFrontier(TeacherConformance):
    teacher = Frontier


class TestStaircase(TeacherConformance):
    @pytest.fixture(scope="class", autouse=True)
    def _made_known(self, experiment: ModuleType) -> None:
        TestStaircase.teacher = experiment.Staircase


def test_a_teacher_takes_less_than_40_lines() -> None:
    file = Path(str(sys.modules[Frontier.__module__].__file__))
    assert len(file.read_text().splitlines()) < 40


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


def test_the_experiment_is_planned(experiment: ModuleType) -> None:
    plan = experiment.CAMPAIGN.plan()
    assert len(plan.runs) == 4
    assert {part for spec in plan.runs for part in spec.plugins} == {"environment", "student", "teacher"}
    assert {spec.mastery_threshold for spec in plan.runs} == {SwingUp.mastery_return}

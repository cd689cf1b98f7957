"""The examples keep what tma_ray's own parts promise; tests/campaign runs them on a cluster."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest
from frontier_teacher import Frontier
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
    @classmethod
    def _made_known(cls, experiment: ModuleType) -> None:
        cls.teacher = experiment.Staircase


def test_a_teacher_takes_less_than_40_lines() -> None:
    file = Path(str(sys.modules[Frontier.__module__].__file__))
    assert len(file.read_text().splitlines()) < 40


def test_the_pendulum_builds_its_task() -> None:
    environment = SwingUp()
    environment.reset(seed=0, options={"task": [0.5, 1.25]})
    assert (environment.m, environment.l) == (0.5, 1.25)


def test_the_experiment_is_planned(experiment: ModuleType) -> None:
    plan = experiment.CAMPAIGN.plan()
    assert len(plan.runs) == 4
    assert {part for spec in plan.runs for part in spec.plugins} == {"environment", "student", "teacher"}
    assert {spec.mastery_threshold for spec in plan.runs} == {SwingUp.mastery_return}

"""The kit passes teachers that keep the contract, and finds the one promise that each broken one breaks."""

from __future__ import annotations

import inspect
import re
import shutil
import subprocess
import sys
import unittest
from pathlib import Path

import broken_teachers
import numpy as np
import pytest
from odd_queries import AsksForTrajectories, AsksForValues

from tma_ray.teachers import TEACHERS, Teacher
from tma_ray.teachers.random import Random
from tma_ray.testing import TeacherConformance, TrialStudent
from tma_ray.testing.conformance import check_quickly
from tma_ray.testing.trials import SCENARIOS

NEW_PROCESS = "test_a_saved_teacher_continues_in_a_new_process"
INSIDE = "test_tasks_stay_inside_the_space"
LOG_ROWS = "test_log_rows_can_be_stored_and_drawn"
FIELDS = "test_hyperparameters_are_fields_with_defaults"
LEVELS = "test_expert_knowledge_levels"
UNTIL_THE_STUDENT_FAILS = "test_tasks_stay_inside_whatever_the_student_does"

BROKEN = {
    "LeavesItsSpace": (INSIDE, "left its space"),
    "GivesFloat64": (INSIDE, "float64 tasks; expected float32"),
    "ProbesOutside": ("test_a_probe_leaves_no_trace", "left its space"),
    "UsesGlobalRandomness": ("test_global_randomness_is_left_alone", "numpy.random"),
    "IsNotSeeded": ("test_the_seed_determines_the_curriculum", "other tasks from episode 0"),
    "IgnoresItsSeed": ("test_the_seed_determines_the_curriculum", "another seed gave the same"),
    "LearnsFromProbes": ("test_a_probe_leaves_no_trace", "changed the tasks from episode 0"),
    "ForgetsWhenSaved": (NEW_PROCESS, "end in an underscore"),
    "LogsSingularCovariances": (LOG_ROWS, "not positive definite"),
    "LogsBoxesUpsideDown": (LOG_ROWS, "upside down"),
    "LogsInfinity": (LOG_ROWS, "ratio = inf"),
    "ListsIdleLevels": (LEVELS, "do not list it"),
    "ListsFallingLevels": (LEVELS, "let them rise"),
    "ChangesHyperparameters": ("test_hyperparameters_never_change", r"\['tries'\]"),
    "NeedsHyperparameters": (FIELDS, r"\['target'\] defaults"),
    "IsNoDataclass": (FIELDS, "decorate the class"),
    "TakesAnything": ("test_unknown_hyperparameters_are_refused", "leave the constructor"),
    "NeedsSuccess": (UNTIL_THE_STUDENT_FAILS, "left its space with .*nan"),
}

ALSO = {
    "LeavesItsSpace": {UNTIL_THE_STUDENT_FAILS},
    "GivesFloat64": {UNTIL_THE_STUDENT_FAILS},
    "IsNotSeeded": {"test_a_probe_leaves_no_trace"},
    "LogsSingularCovariances": {UNTIL_THE_STUDENT_FAILS},
    "LogsBoxesUpsideDown": {UNTIL_THE_STUDENT_FAILS},
    "LogsInfinity": {UNTIL_THE_STUDENT_FAILS},
}
"""What else cannot be kept by who breaks that promise."""


def failures(teacher: type[Teacher], *, new_process: bool) -> dict[str, str]:
    """Run the whole kit by hand; return the messages of what failed by the name of the promise."""
    scenarios = SCENARIOS[1:3]
    arguments = {"scenario": scenarios, "pupil": [TrialStudent.HOPELESS, TrialStudent.PERFECT]}
    kit = type("Kit", (TeacherConformance,), {"teacher": teacher, "scenarios": scenarios, "episodes": 215})()
    failed: dict[str, str] = {}
    for name, method in inspect.getmembers(kit, inspect.ismethod):
        if not name.startswith("test_") or (name == NEW_PROCESS and not new_process):
            continue
        parameters = list(inspect.signature(method).parameters)
        for values in [{parameters[0]: value} for value in arguments[parameters[0]]] if parameters else [{}]:
            try:
                method(**values)
            except (AssertionError, TypeError) as error:
                failed.setdefault(name, str(error))
    return failed


@pytest.mark.parametrize("name", BROKEN)
def test_the_broken_promise_is_found_and_no_other(name: str) -> None:
    promise, message = BROKEN[name]
    failed = failures(getattr(broken_teachers, name), new_process=promise == NEW_PROCESS)
    if name == "NeedsHyperparameters":  # cannot even be made
        assert re.search(message, failed[promise])
        return
    assert set(failed) == {promise} | ALSO.get(name, set())
    assert re.search(message, failed[promise]), failed[promise]


@pytest.mark.parametrize("name", ["NeverStartsItsBase", "UsesItsSpaceTooEarly"])
def test_a_base_class_that_is_not_started_is_told_once(name: str) -> None:
    teacher = getattr(broken_teachers, name)
    kit = type("Kit", (TeacherConformance,), {"teacher": teacher, "episodes": 215})()
    with pytest.raises(AssertionError, match=r"does not call super\(\)\.start\(space, knowledge, rng\)"):
        kit.test_the_seed_determines_the_curriculum(SCENARIOS[1])
    for promise in ("test_tasks_stay_inside_the_space", "test_a_probe_leaves_no_trace"):
        with pytest.raises(unittest.SkipTest, match="does not call"):
            getattr(kit, promise)(SCENARIOS[2])


@pytest.mark.parametrize("teacher", [Random, AsksForValues, AsksForTrajectories])
def test_who_keeps_the_contract_passes(teacher: type[Teacher]) -> None:
    """One of them in a new process, too."""
    assert failures(teacher, new_process=teacher is AsksForTrajectories) == {}


def test_a_teacher_that_no_process_can_import_is_told_so() -> None:
    class Local(Random): ...

    kit = type("Kit", (TeacherConformance,), {"teacher": Local, "scenarios": SCENARIOS[:1]})()
    with pytest.raises(RuntimeError, match=r"find it as test_conformance\..*Local"):
        getattr(kit, NEW_PROCESS)()


def test_trajectories_have_to_be_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(AsksForTrajectories, "wants_trajectory", False)
    kit = type("Kit", (TeacherConformance,), {"teacher": AsksForTrajectories})()
    with pytest.raises(ValueError, match="wants_trajectory = True"):
        kit.test_tasks_stay_inside_the_space(SCENARIOS[0])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Grid", r"Grid fails in the task space a 0\.\.1, fixed 10\.\.10, .*declare its limits"),
        ("FreeGrid", r"does not start in 20 dimensions \(Unable to allocate 26.* PiB.*most_dimensions"),
    ],
)
def test_limits_that_are_not_declared_are_told_before_anything_is_spent(name: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_quickly(f"grid_teacher:{name}")


def test_a_teacher_is_tested_within_the_limits_that_it_declares() -> None:
    check_quickly("grid_teacher:SmallGrid")
    kit = type("Kit", (TeacherConformance,), {"teacher": TEACHERS.get("grid_teacher:SmallGrid")})
    assert kit.claimed_scenarios() == list(SCENARIOS[:2])


@pytest.mark.slow
def test_a_third_party_runs_it_with_pytest(tmp_path: Path) -> None:
    """Teacher and test of the page on new teachers, in a project of their own."""
    root = Path(__file__).parents[2]
    shutil.copy(root / "examples" / "frontier_teacher.py", tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (root / "docs" / "add_teacher.md").read_text(), re.DOTALL)
    (test,) = (block for block in blocks if "class TestFrontier(" in block)
    (tmp_path / "test_frontier.py").write_text(test)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout
    passed = re.search(r"(\d+) passed", result.stdout)
    assert passed is not None
    assert int(passed.group(1)) > 25


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)
def test_scenarios_hold_easy_and_hard_tasks(scenario) -> None:
    """Else a kit would never see a success, or a failure."""
    tasks = scenario.space.sample(np.random.default_rng(0), 200)
    for index in (0, 300):
        successes = [scenario.episode(task, index, TrialStudent.IMPROVING).success for task in tasks]
        assert 0.1 < np.mean(successes) < 0.9


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)
def test_scenarios_hold_tasks_that_are_mastered_now_and_then(scenario) -> None:
    """Else a teacher that looks for intermediate difficulty would find none."""
    tasks = scenario.space.sample(np.random.default_rng(0), 200)
    first, second = (
        [scenario.episode(task, index, TrialStudent.IMPROVING).success for task in tasks] for index in (0, 1)
    )
    assert 0.1 < np.mean(np.not_equal(first, second)) < 0.5

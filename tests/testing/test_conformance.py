"""The kit passes teachers that keep the contract, and finds the one promise that each broken one breaks."""

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

from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers import TEACHERS, Teacher, hyperparameters_of, make_teacher
from tma_ray.teachers.random import Random
from tma_ray.testing import ScriptedStudent, TeacherConformance
from tma_ray.testing.conformance import check_quickly
from tma_ray.testing.scenarios import SCENARIOS

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

LOGS = ("LogsSingularCovariances", "LogsBoxesUpsideDown", "LogsInfinity")
ALSO = {name: {UNTIL_THE_STUDENT_FAILS} for name in ("LeavesItsSpace", "GivesFloat64", *LOGS)}
ALSO["IsNotSeeded"] = {"test_a_probe_leaves_no_trace"}
"""What else cannot be kept by who breaks that promise."""


CONSTANT = SCENARIOS[2]


def kit_of(teacher: type[Teacher]) -> TeacherConformance:
    """Return the kit with one scenario, twice: saved after no episode, and after one."""
    members = {"teacher": teacher, "scenarios": [CONSTANT, CONSTANT], "episodes": 215}
    return type("Kit", (TeacherConformance,), members)()


def failures(teacher: type[Teacher], *, new_process: bool) -> dict[str, str]:
    """Run the whole kit by hand; return the messages of what failed by the name of the promise."""
    arguments = {"scenario": [CONSTANT], "student": [ScriptedStudent.HOPELESS, ScriptedStudent.PERFECT]}
    kit, failed = kit_of(teacher), {}
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
    kit = kit_of(getattr(broken_teachers, name))
    with pytest.raises(AssertionError, match=r"does not call super\(\)\.start\(space, knowledge, rng\)"):
        kit.test_the_seed_determines_the_curriculum(CONSTANT)
    for promise in ("test_tasks_stay_inside_the_space", "test_a_probe_leaves_no_trace"):
        with pytest.raises(unittest.SkipTest, match="does not call"):
            getattr(kit, promise)(CONSTANT)


@pytest.mark.parametrize("teacher", [Random, AsksForValues, AsksForTrajectories])
def test_who_keeps_the_contract_passes(teacher: type[Teacher]) -> None:
    """One of them in a new process, too."""
    assert failures(teacher, new_process=teacher is AsksForTrajectories) == {}


def test_a_teacher_that_no_process_can_import_is_told_so() -> None:
    class Local(Random): ...

    with pytest.raises(RuntimeError, match=r"find it as test_conformance\..*Local"):
        getattr(kit_of(Local), NEW_PROCESS)()


def test_trajectories_have_to_be_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(AsksForTrajectories, "wants_trajectory", False)
    with pytest.raises(ValueError, match="wants_trajectory = True"):
        kit_of(AsksForTrajectories).test_tasks_stay_inside_the_space(CONSTANT)


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


@pytest.mark.parametrize("name", [*TEACHERS.names(), "accel:score=mna"])
def test_a_teacher_is_tested_with_hyperparameters_of_their_types(name: str) -> None:
    teacher = make_teacher(name)
    tested = SCENARIOS[0].started(type(teacher), hyperparameters_of(teacher), KnowledgeLevel.HIGH)
    assert repr(tested) == repr(teacher)  # text is equal to a member of a StrEnum, but not shown alike


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
def test_scenarios_hold_easy_and_hard_tasks_and_some_that_are_mastered_now_and_then(scenario) -> None:
    """Else a kit would never see a success or a failure, and a teacher no intermediate difficulty."""
    tasks = scenario.space.sample(np.random.default_rng(0), 200)
    kind = ScriptedStudent.IMPROVING
    first, second, late = ([scenario.episode(x, i, kind).success for x in tasks] for i in (0, 1, 300))
    for successes in (first, late):
        assert 0.1 < np.mean(successes) < 0.9
    assert 0.1 < np.mean(np.not_equal(first, second)) < 0.5

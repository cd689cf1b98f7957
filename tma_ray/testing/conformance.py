"""Conformance tests of teachers, as a test class to inherit from."""

import copy
import dataclasses
import inspect
import json
import pickle
import random
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar
from unittest import SkipTest

import numpy as np

from tma_ray.tasks import KnowledgeLevel, TeacherUpdate
from tma_ray.teachers import Teacher, effective_level, hyperparameters_of, make_teacher
from tma_ray.testing.scenarios import (
    SCENARIOS,
    SavedTeacher,
    Scenario,
    ScriptedStudent,
    check_tasks,
    check_update,
    first_difference,
    play,
    resume_in_new_process,
)

SAVED_AFTER = (0, 1, 149, 150, 211)
"""Numbers of episodes after which teachers are saved (one per scenario), around the ends of batches."""

SET_BY_START = ("space", "knowledge", "rng")  # attributes that `Teacher.start` sets

QUICK_SCENARIOS = 3  # number of scenarios played by the quick check; in others, it only starts the teacher
PROBED = 20  # number of tasks per probe


@dataclass(frozen=True)
class UndisturbedPlay:
    """Uninterrupted reference rollout of a teacher: its tasks, pickled states by episode, and log."""

    tasks: list[Any]
    states: Mapping[int, bytes]
    updates: list[TeacherUpdate]


_PLAYS: dict[tuple[type, str], UndisturbedPlay] = {}

_UNSTARTED: set[type] = set()  # teachers that do not call `Teacher.start`


class TeacherConformance:
    """Conformance tests of a teacher.

    Inherit from it in a test module, and name the teacher, which other processes must be able to import::

        class TestMyTeacher(TeacherConformance):
            teacher = MyTeacher

    Most tests run for each of `scenarios`. pytest is needed to run the class, not to import it.

    Attributes:
        teacher: class of the teacher.
        hyperparameters: hyper-parameters for the tests, for instance smaller networks.
        scenarios: task spaces of the tests.
        episodes: number of episodes of each rollout; more than `SAVED_AFTER`, and enough for updates.
    """

    teacher: ClassVar[type[Teacher]]
    hyperparameters: ClassVar[Mapping[str, Any]] = {}
    scenarios: ClassVar[Sequence[Scenario]] = SCENARIOS
    episodes: ClassVar[int] = 320

    @classmethod
    def claimed_scenarios(cls) -> list[Scenario]:
        """Return the `scenarios` within the teacher's declared limits."""
        claimed = [scenario for scenario in cls.scenarios if not cls.teacher.refusal(scenario.space)]
        assert claimed, f"{cls.teacher.__name__} declares limits within which no scenario is; raise them"
        return claimed

    def pytest_generate_tests(self, metafunc: Any) -> None:
        """Parametrise tests by scenario and by scripted student (pytest hook)."""
        if "scenario" in metafunc.fixturenames:
            claimed = self.claimed_scenarios() if hasattr(self, "teacher") else self.scenarios
            metafunc.parametrize("scenario", claimed, ids=[scenario.name for scenario in claimed])
        if "student" in metafunc.fixturenames:
            metafunc.parametrize("student", [ScriptedStudent.HOPELESS, ScriptedStudent.PERFECT])

    def test_hyperparameters_are_fields_with_defaults(self) -> None:
        """Check that hyper-parameters have defaults and that their values are valid JSON."""
        assert issubclass(self.teacher, Teacher), f"{self._name} does not inherit from Teacher"
        annotated = set(inspect.get_annotations(self.teacher))
        forgotten = sorted(annotated - set(self.teacher.__dataclass_fields__))
        assert not forgotten, f"{self._name}: {forgotten} must be fields; decorate the class with @dataclass"
        needed = [
            field.name
            for field in dataclasses.fields(self.teacher)
            if field.init and field.default is field.default_factory is dataclasses.MISSING
        ]
        assert not needed, f"{self._name}: give the hyper-parameters {needed} defaults"
        json.dumps(hyperparameters_of(self.teacher()))

    def test_unknown_hyperparameters_are_refused(self) -> None:
        """Check that unknown hyper-parameters are rejected."""
        try:
            self.teacher(no_such_hyperparameter=1)  # type: ignore[call-arg]
        except TypeError:
            return
        raise AssertionError(
            f"{self._name} takes a hyper-parameter that it does not have; leave the constructor to @dataclass"
        )

    def test_hyperparameters_never_change(self) -> None:
        """Check that learning does not change hyper-parameters."""
        teacher = self._started(self.claimed_scenarios()[0])
        before = copy.deepcopy(hyperparameters_of(teacher))
        play(teacher, self.claimed_scenarios()[0], 0, self.episodes // 2)
        after = hyperparameters_of(teacher)
        changed = [name for name in before if before[name] != after[name]]
        assert not changed, f"{self._name} changed its hyper-parameters {changed} while it was learning"

    def test_expert_knowledge_levels(self) -> None:
        """Check that the listed levels work and make a difference, and that lower ones are rejected."""
        levels = self.teacher.knowledge_levels
        ranks = [level.rank for level in levels]
        assert ranks, f"{self._name} lists no knowledge_levels; name at least the one that it needs"
        assert ranks == sorted(set(ranks)), f"{self._name} lists knowledge_levels {levels}; let them rise"
        for level in KnowledgeLevel:
            if level.rank < ranks[0]:
                refusal = ""
                try:
                    effective_level(self.teacher, self._name, level)
                except ValueError as error:
                    refusal = str(error)
                problem = f"{self._name} cannot run at level {level.value!r} and does not say so"
                assert self._name in refusal, problem
            else:
                assert effective_level(self.teacher, self._name, level) in levels
        scenario = self.claimed_scenarios()[0]
        plays = [
            play(self._started(scenario, level=level), scenario, 0, self.episodes) for level in levels[:-1]
        ] + [self._undisturbed(scenario).tasks]
        for lower, higher, level in zip(plays, plays[1:], levels[1:], strict=False):
            check_tasks(lower, scenario.space, self._name)
            assert first_difference(lower, higher) is not None, (
                f"{self._name} does at level {level.value!r} what it does below; do not list it, so that "
                f"runs are shared instead of repeated"
            )

    def test_tasks_stay_inside_the_space(self, scenario: Scenario) -> None:
        """Check that tasks are float32 vectors within the bounds of the space."""
        check_tasks(self._undisturbed(scenario).tasks, scenario.space, self._name)

    def test_tasks_stay_inside_whatever_the_student_does(self, student: ScriptedStudent) -> None:
        """Check that tasks stay inside the space if nothing or everything is mastered."""
        scenario = self.claimed_scenarios()[-1]
        teacher = self._started(scenario)
        check_tasks(play(teacher, scenario, 0, self.episodes, student), scenario.space, self._name)
        for update in teacher.drain_updates():
            check_update(update, scenario.space, self._name)

    def test_the_seed_determines_the_curriculum(self, scenario: Scenario) -> None:
        """Check that equal seeds give bit-identical tasks, and different seeds different ones."""
        tasks = self._undisturbed(scenario).tasks
        again = play(self._started(scenario), scenario, 0, self.episodes)
        assert first_difference(tasks, again) is None, (
            f"{self._name}: the same seed gave other tasks from episode {first_difference(tasks, again)} on; "
            f"draw from self.rng only, and never iterate over sets"
        )
        other = self._started(scenario, seed=1)
        for first in range(0, self.episodes, 10):
            last = min(first + 10, self.episodes)
            if first_difference(tasks[first:last], play(other, scenario, first, last)) is not None:
                return
        raise AssertionError(f"{self._name}: another seed gave the same tasks; draw from self.rng")

    def test_global_randomness_is_left_alone(self) -> None:
        """Check that the teacher does not change the global random state of its process."""
        scenario = self.claimed_scenarios()[0]
        teacher = self._started(scenario)
        play(teacher, scenario, 0, 1)
        before = global_state()
        play(teacher, scenario, 1, self.episodes // 2)
        teacher.probe(PROBED)
        changed = [name for name, state in global_state().items() if state != before.get(name, state)]
        assert not changed, f"{self._name} changed the global state of {changed}; draw from self.rng only"

    def test_a_probe_leaves_no_trace(self, scenario: Scenario) -> None:
        """Check that a probe is repeatable, stays inside the space, and does not affect later tasks."""
        teacher, tasks = self._started(scenario), []
        for first in range(0, self.episodes, 80):
            probe, again = teacher.probe(PROBED), teacher.probe(PROBED)
            assert len(probe) == PROBED, f"{self._name}: probe({PROBED}) gave {len(probe)} tasks"
            check_tasks(probe, scenario.space, self._name)
            assert first_difference(probe, again) is None, (
                f"{self._name}: two probes in a row differ; draw them from self.probe_rng()"
            )
            tasks += play(teacher, scenario, first, min(first + 80, self.episodes))
        difference = first_difference(tasks, self._undisturbed(scenario).tasks)
        assert difference is None, (
            f"{self._name}: a probe changed the tasks from episode {difference} on; draw from "
            f"self.probe_rng(), and change no attribute"
        )

    def test_a_saved_teacher_continues_in_a_new_process(self) -> None:
        """Check that a saved teacher continues bit for bit in a new process."""
        scenarios = self.claimed_scenarios()
        plays = [self._undisturbed(scenario) for scenario in scenarios]
        after = [SAVED_AFTER[index % len(SAVED_AFTER)] for index in range(len(plays))]
        saved = tuple(
            SavedTeacher(scenario, reference.states[episodes], episodes, self.episodes)
            for scenario, reference, episodes in zip(scenarios, plays, after, strict=True)
        )
        resumed = resume_in_new_process(self.teacher, self.hyperparameters, self._level, saved)
        for start, reference, tasks in zip(saved, plays, resumed, strict=True):
            difference = first_difference(tasks, reference.tasks[start.episodes :])
            assert difference is None, (
                f"{self._name}, saved after {start.episodes} episodes in the scenario "
                f"{start.scenario.name!r} and continued in a new process, gave other tasks from the "
                f"{difference}th on: let the names of all that is learned end in an underscore"
            )

    def test_log_rows_can_be_stored_and_drawn(self, scenario: Scenario) -> None:
        """Check that log rows are finite, well-formed, and returned only once."""
        for update in self._undisturbed(scenario).updates:
            check_update(update, scenario.space, self._name)
        teacher = self._started(scenario)
        play(teacher, scenario, 0, 2)
        teacher.drain_updates()
        assert teacher.drain_updates() == [], f"{self._name}: drain_updates() gave the same rows twice"

    @property
    def _name(self) -> str:
        return self.teacher.__name__

    @property
    def _level(self) -> KnowledgeLevel:
        return self.teacher.knowledge_levels[-1]

    def _started(self, scenario: Scenario, seed: int = 0, level: KnowledgeLevel | None = None) -> Teacher:
        """Return a started teacher; if it never calls `super().start`, fail once, and skip later tests."""
        if self.teacher in _UNSTARTED:
            raise SkipTest(f"{self._name}.start() does not call super().start()")
        try:
            teacher = scenario.started(self.teacher, self.hyperparameters, level or self._level, seed)
        except AttributeError as error:  # the teacher uses attributes that its base class sets
            if error.name not in SET_BY_START:
                raise
        except (MemoryError, ValueError) as error:
            raise AssertionError(
                f"{self._name} does not start in {scenario.space.size} dimensions ({error}): declare its "
                f"limits in its class, most_dimensions, constant_dimensions or single_task, or let it do "
                f"without them"
            ) from error
        else:
            if all(name in vars(teacher) for name in SET_BY_START):
                return teacher
        _UNSTARTED.add(self.teacher)
        raise AssertionError(
            f"{self._name}.start() does not call super().start(space, knowledge, rng), which sets "
            f"{', '.join(f'self.{name}' for name in SET_BY_START)}: call it first"
        )

    def _undisturbed(self, scenario: Scenario) -> UndisturbedPlay:
        """Return the cached reference rollout with seed 0."""
        key = (type(self), scenario.name)
        if key not in _PLAYS:
            teacher = self._started(scenario)
            tasks: list[Any] = []
            states = {}
            for first, last in zip((0, *SAVED_AFTER), (*SAVED_AFTER, self.episodes), strict=True):
                tasks += play(teacher, scenario, first, last)
                states[last] = pickle.dumps(teacher.state())
            _PLAYS[key] = UndisturbedPlay(tasks, states, teacher.drain_updates())
        return _PLAYS[key]


def check_quickly(name: str) -> None:
    """Run the most important conformance tests of a teacher within seconds, without pytest.

    Args:
        name: registered name or ``module:Name``, optionally with hyper-parameters.

    Raises:
        ValueError: if a test fails, with a remedy.
    """
    teacher = make_teacher(name)
    members = {"teacher": type(teacher), "hyperparameters": hyperparameters_of(teacher)}
    contract = type(f"Quick{type(teacher).__name__}", (TeacherConformance,), members)()
    try:
        contract.test_hyperparameters_are_fields_with_defaults()
        contract.test_unknown_hyperparameters_are_refused()
        contract.test_hyperparameters_never_change()
        for number, scenario in enumerate(contract.claimed_scenarios()):
            try:
                contract._started(scenario)
                if number < QUICK_SCENARIOS:
                    contract.test_tasks_stay_inside_the_space(scenario)
                    contract.test_the_seed_determines_the_curriculum(scenario)
            except AssertionError:
                raise
            except Exception as error:  # raised by the teacher's own code
                bounds = zip(scenario.space.names, scenario.space.low, scenario.space.high, strict=True)
                box = ", ".join(f"{dimension} {low:g}..{high:g}" for dimension, low, high in bounds)
                raise ValueError(
                    f"{name} fails in the task space {box} ({error!r}): correct it, or declare its limits in "
                    f"its class, most_dimensions, constant_dimensions or single_task; --debug shows where"
                ) from error
    except AssertionError as error:
        raise ValueError(f"{name} breaks the contract of teachers: {error}") from error


def global_state() -> dict[str, Any]:
    """Return the process-wide random states and settings, including torch's if torch is imported."""
    state: dict[str, Any] = {
        "random": random.getstate(),
        "numpy.random": pickle.dumps(np.random.get_state()),  # noqa: NPY002 - compared, not used
    }
    torch = sys.modules.get("torch")
    if torch is not None:
        state["torch's generator"] = torch.get_rng_state().numpy().tobytes()
        state["torch's default dtype"] = torch.get_default_dtype()
        state["torch's number of threads"] = torch.get_num_threads()
        state["torch's grad mode"] = torch.is_grad_enabled()
    return state

"""Scenarios of the conformance tests: task spaces, scripted students and resumed rollouts."""

import importlib
import pickle
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tma_ray.components.settings import parse_settings
from tma_ray.tasks import (
    MASTERY_RETURN,
    Episode,
    KnowledgeLevel,
    Outcomes,
    ShuffledSpace,
    Task,
    TaskSpace,
    TeacherUpdate,
    expert_knowledge,
)
from tma_ray.teachers import Teacher
from tma_ray.testing.students import report_episode


def check_tasks(tasks: Iterable[Any], space: TaskSpace, name: str) -> None:
    """Check that tasks are float32 vectors inside `space`."""
    for task in tasks:
        assert isinstance(task, np.ndarray), f"{name} gave {task!r}; expected a numpy array"
        assert task.dtype == np.float32, f"{name} gave {task.dtype} tasks; expected float32 (space.clip)"
        assert task.shape == (space.size,), f"{name} gave shape {task.shape}; expected ({space.size},)"
        assert space.contains(task), (
            f"{name} left its space with {task.tolist()}: bounds are {space.low.tolist()} to "
            f"{space.high.tolist()}; clip with space.clip"
        )


def check_update(update: TeacherUpdate, space: TaskSpace, name: str) -> None:
    """Check that a log row matches `space` and can be plotted."""
    square = (space.size, space.size)
    for gaussian in update.gaussians:
        assert np.shape(gaussian.mean) == (space.size,), (
            f"{name} logs a mean of shape {np.shape(gaussian.mean)}"
        )
        assert np.shape(gaussian.covariance) == square, (
            f"{name} logs a covariance of shape {np.shape(gaussian.covariance)}; expected {square}"
        )
        numbers = [gaussian.weight, *np.ravel(gaussian.mean), *np.ravel(gaussian.covariance)]
        assert np.all(np.isfinite(numbers)), f"{name} logs a Gaussian that is not finite: {gaussian}"
        assert gaussian.weight >= 0, f"{name} logs a Gaussian of negative weight: {gaussian}"
        assert np.allclose(gaussian.covariance, np.transpose(gaussian.covariance)), (
            f"{name} logs an asymmetric {gaussian}"
        )
        assert np.all(np.linalg.eigvalsh(gaussian.covariance) > 0), (
            f"{name} logs a covariance that is not positive definite: {gaussian.covariance}"
        )
    for box in update.boxes:
        assert np.shape(box.low) == np.shape(box.high) == (space.size,), f"{name} logs a misshapen {box}"
        numbers = [box.score, *box.low, *box.high]
        assert np.all(np.isfinite(numbers)), f"{name} logs a box that is not finite: {box}"
        assert np.all(np.asarray(box.low) <= np.asarray(box.high)), f"{name} logs a box upside down: {box}"
    for key, value in update.scalars.items():
        assert np.isfinite(value), f"{name} logs {key} = {value}; expected a finite number"


def first_difference(first: Iterable[Any], second: Iterable[Any]) -> int | None:
    """Return the index of the first difference between two sequences of tasks, or None if they are equal."""
    for index, (one, other) in enumerate(zip(first, second, strict=True)):
        if not np.array_equal(one, other):
            return index
    return None


STEPS = 1_000  # length of episodes: 100 of them reach updates due every 100,000 steps
VALUE_SHARE = 0.05  # discounted returns and state values as a share of the episodic return
UNSTEADINESS = 60.0  # amplitude of the improving student's alternating returns, so that it masters some tasks


class ScriptedStudent(StrEnum):
    """Scripted student whose returns depend only on task and episode number, to make rollouts resumable."""

    IMPROVING = "improving"
    """Student that masters a growing share of the tasks, the easiest first."""

    HOPELESS = "hopeless"
    """Student with return -100 on every task."""

    PERFECT = "perfect"
    """Student with return 300 on every task."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """Setting of a conformance test: a task space, possibly with shuffled regions.

    Attributes:
        name: name in test ids.
        space: task space, whose lower corner is the easiest task of the world.
        rugged: True to shuffle the space.
    """

    name: str
    space: TaskSpace
    rugged: bool = False

    @cached_property
    def landscape(self) -> ShuffledSpace:
        """Map from the teacher's tasks to the world's; the identity unless the scenario is rugged."""
        return ShuffledSpace.shuffle(self.space, np.random.default_rng(3), cuts=4 if self.rugged else 1)

    def started(
        self, teacher: type[Teacher], hyperparameters: Mapping[str, Any], level: KnowledgeLevel, seed: int = 0
    ) -> Teacher:
        """Return a new teacher started in this space, with knowledge that depends only on `level`."""
        easy_task = self.landscape.from_world(self.space.low)
        knowledge = expert_knowledge(level, self.space, np.random.default_rng(7), easy_task)
        new = teacher(**parse_settings(teacher, {}, hyperparameters))
        new.start(self.space, knowledge, np.random.default_rng(seed))
        return new

    def episode(self, task: Task, index: int, student: ScriptedStudent) -> Episode:
        """Return the student's episode with number `index` (from 0) on `task`."""
        free = self.space.width > 0
        easy = self.space.clip(np.nan_to_num(task))  # invalid tasks are reported by other checks
        mean = float(self.space.normalise(self.landscape.to_world(easy))[free].mean())
        # for uniform tasks, roughly uniform in [0, 1] in any number of dimensions
        difficulty = 1 / (1 + float(np.exp(-1.7 * np.sqrt(12 * free.sum()) * (mean - 0.5))))
        observation = np.array([difficulty, 0.2 + index / 1000], dtype=np.float32)
        luck = UNSTEADINESS if index % 2 else -UNSTEADINESS
        fixed = {ScriptedStudent.HOPELESS: -100.0, ScriptedStudent.PERFECT: 300.0}
        episodic_return = fixed.get(student, float(_returns(observation[None])[0]) + luck)
        return Episode(
            task=task,
            episodic_return=episodic_return,
            success=episodic_return > MASTERY_RETURN,
            length=STEPS,
            initial_observation=observation,
            discounted_return=VALUE_SHARE * episodic_return,
            step=STEPS * (index + 1),
        )

    def outcomes(self, tasks: Task, index: int, student: ScriptedStudent) -> Outcomes:
        """Return the student's outcomes on `tasks` (n, d) after the episode with number `index`."""
        episodes = [self.episode(task, index, student) for task in tasks]
        episodic_returns = np.array([episode.episodic_return for episode in episodes])
        return Outcomes(
            episodic_returns, episodic_returns > MASTERY_RETURN, np.full(len(tasks), STEPS, dtype=np.int64)
        )


SCENARIOS = (
    Scenario("line", TaskSpace.from_bounds({"x": (-1, 1)})),
    Scenario("plane", TaskSpace.from_bounds({"stump_height": (0, 3), "obstacle_spacing": (0, 6)})),
    Scenario("constant", TaskSpace.from_bounds({"a": (0, 1), "fixed": (10, 10), "b": (-500, 500)})),
    Scenario("rugged", TaskSpace.from_bounds({"a": (0, 3), "fixed": (0, 0), "b": (0, 6)}), rugged=True),
    Scenario("twenty", TaskSpace.from_bounds({f"x{index}": (-index, index + 0.5) for index in range(20)})),
)
"""One to twenty dimensions, of equal and of very different widths, with and without constants."""


def play(
    teacher: Teacher,
    scenario: Scenario,
    first: int,
    last: int,
    student: ScriptedStudent = ScriptedStudent.IMPROVING,
) -> list[Task]:
    """Play the episodes numbered `first` to `last` (exclusive), and return their tasks."""
    tasks = []

    def values(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        return VALUE_SHARE * _returns(observations)

    def evaluate(queried: Task, _greedy: bool) -> Outcomes:
        check_tasks(queried, scenario.space, "the query for an evaluation")
        return scenario.outcomes(queried, index, student)

    for index in range(first, last):
        proposal = teacher.propose()
        tasks.append(proposal.task)
        episode = replace(scenario.episode(proposal.task, index, student), trains=proposal.trains)
        report_episode(teacher, episode, values, evaluate)
    return tasks


def _returns(observations: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the improving student's expected returns (n,) from observations (n, 2): difficulty, skill."""
    difficulty, skill = observations.astype(np.float64).T
    returns: NDArray[np.float64] = 300 - 400 * np.clip(difficulty - skill, 0, 1)
    return returns


@dataclass(frozen=True)
class SavedTeacher:
    """Pickled state of a teacher after `episodes` of a scenario, to be resumed until episode `last`."""

    scenario: Scenario
    state: bytes
    episodes: int
    last: int


START = "import sys; sys.path[:] = sys.argv[1:]; from tma_ray.testing.scenarios import main; main()"
"""Code of the new process, which gets the import path of this one."""


def resume_in_new_process(
    teacher: type[Teacher],
    hyperparameters: Mapping[str, Any],
    level: KnowledgeLevel,
    saved: tuple[SavedTeacher, ...],
) -> list[Task]:
    """Resume saved teachers in a new process, and return the tasks (n, d) of each.

    Raises:
        RuntimeError: if the new process fails, with its errors.
    """
    job = (teacher.__module__, teacher.__qualname__, hyperparameters, level, saved)
    command = [sys.executable, "-c", START, *sys.path]
    process = subprocess.run(command, input=pickle.dumps(job), capture_output=True, check=False)  # noqa: S603
    if process.returncode:
        raise RuntimeError(
            f"{teacher.__name__} could not be continued in a new process, which has to find it as "
            f"{teacher.__module__}.{teacher.__qualname__}:\n{process.stderr.decode()}"
        )
    tasks: list[Task] = pickle.loads(process.stdout)
    return tasks


def main() -> None:
    """Run the job given on standard input, and write a list of tasks (n, d) to standard output."""
    module, name, hyperparameters, level, states = pickle.load(sys.stdin.buffer)
    teacher = attrgetter(name)(importlib.import_module(module))
    results = []
    for saved in states:
        new = saved.scenario.started(teacher, hyperparameters, level, seed=99)  # the state replaces the seed
        new.load_state(pickle.loads(saved.state))
        results.append(np.stack(play(new, saved.scenario, saved.episodes, saved.last)))
    sys.stdout.buffer.write(pickle.dumps(results))

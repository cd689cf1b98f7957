"""Curriculum driven by a teacher, for use in any training loop."""

import copy
import os
import pickle
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from threading import RLock
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from gymnasium.vector import AsyncVectorEnv, VectorEnv

from tma_ray.curriculum.episodes import Apply, Array, Assignment, Environment, PlayedEpisode
from tma_ray.curriculum.record import EpisodeRow, write_record
from tma_ray.curriculum.shared import CurriculumServer, SharedCurriculum
from tma_ray.curriculum.wrappers import CurriculumEnvironment, restarted, wrap_vector
from tma_ray.runs.run import teacher_log_row
from tma_ray.runs.teaching import CheckedTeacher
from tma_ray.support.quantities import SEED
from tma_ray.support.validation import check_finite
from tma_ray.tasks import (
    Answer,
    Episode,
    Gaussian,
    KnowledgeLevel,
    Outcomes,
    Query,
    QueryKind,
    Task,
    TaskSpace,
    Trajectory,
)
from tma_ray.tasks import expert_knowledge as knowledge_of
from tma_ray.teachers import TEACHERS, Teacher, check_limits, effective_level, make_teacher

Values: TypeAlias = Callable[[Array], Array]
Act: TypeAlias = Callable[[Array], Array]
Evaluate: TypeAlias = Callable[[Task, bool], Outcomes]
Space: TypeAlias = TaskSpace | Mapping[str, tuple[float, float]] | Environment

STATE = "curriculum.pickle"  # file of a saved curriculum, beside its record


def needs_of(teacher: type[Teacher]) -> list[str]:
    """Return the names of the `Curriculum` arguments that a teacher requires."""
    evaluates = teacher.wants_evaluations and not teacher.withholds_episodes
    needed = {"values": teacher.wants_values, "act": teacher.withholds_episodes, "evaluate": evaluates}
    return [name for name, needs in needed.items() if needs]


def teacher_needs() -> pd.DataFrame:
    """Return a table of the teachers' requirements on training loops.

    Returns:
        Columns ``teacher``, ``needs`` (arguments of `Curriculum`), ``expert_knowledge`` (the lowest level)
        and ``several_worlds`` (True if episodes may overlap).
    """
    rows = []
    for name in TEACHERS.names():
        teacher = TEACHERS.get(name)
        least: KnowledgeLevel = teacher.knowledge_levels[0]
        rows.append((name, ", ".join(needs_of(teacher)), least.value, teacher.overlapping))
    return pd.DataFrame(rows, columns=["teacher", "needs", "expert_knowledge", "several_worlds"])


class Curriculum:
    """Curriculum driven by a teacher, for use in any training loop.

    Wrap the loop's environments: `reset` takes the teacher's next task, and every end of an episode, by
    termination or truncation, is reported to the teacher. Episodes from which the student must not learn
    (those of robust PLR, ACCEL and TRACED) are played by the wrapper with `act` or, with `marks_withheld`, by
    the loop.
    `teacher_needs` lists the arguments that each teacher requires.

    Pickles and copies are handles of the same curriculum; see `shared`.

    Args:
        teacher: name with settings ("alp_gmm:fit_every=100", "file:Class"), a class, or a teacher that has
            not been started.
        space: task space, dict of names to bounds, or environment with a `task_space`.
        mastery_return: episodic return over which a task is mastered.
        seed: seed of the teacher.
        expert_knowledge: level of expert knowledge; the teacher may use less.
        easy_task: an easy task (d,), mean of the initial distribution at the level high.
        initial: initial distribution; None for the benchmark's.
        target: target distribution; None for the benchmark's.
        gamma: the student's discount factor.
        values: function that returns values (n,) of observations (n, o) under the current student.
        act: function that returns actions (n, a) of the exploring policy for observations (n, o).
        evaluate: function (tasks (n, d), greedy) that returns the `Outcomes` of one episode of each, such as
            a `TaskEvaluation`.
        marks_withheld: True for a loop that excludes steps with a false ``info["trains"]`` from its updates,
            so that it can play episodes without learning, and `act` is not needed.

    Raises:
        UnknownNameError: if the teacher is unknown.
        ValueError: if the teacher does not support a setting, the level or the space, or needs a function.

    Attributes:
        steps: environment steps of the episodes so far.

    Examples:
        >>> curriculum = Curriculum("alp_gmm", {"mass": (0.5, 2.0)}, mastery_return=-300, seed=1)
        >>> curriculum.begin().task.shape
        (1,)
    """

    def __init__(  # noqa: PLR0913 - one argument per setting of the benchmark's runs, under its name
        self,
        teacher: str | type[Teacher] | Teacher,
        space: Space,
        *,
        mastery_return: float,
        seed: int = 0,
        expert_knowledge: KnowledgeLevel | str = KnowledgeLevel.NONE,
        easy_task: Task | None = None,
        initial: Gaussian | None = None,
        target: Gaussian | None = None,
        gamma: float = 0.99,
        values: Values | None = None,
        act: Act | None = None,
        evaluate: Evaluate | None = None,
        marks_withheld: bool = False,
    ) -> None:
        check_finite("mastery_return", mastery_return)
        check_finite("gamma", gamma)
        SEED.check("seed", seed)
        self.space, self.gamma, self.mastery_return = _task_space(space), gamma, mastery_return
        self.marks_withheld, self.seed, self.steps = marks_withheld, seed, 0
        self._teacher, self._name = _new_teacher(teacher)
        check_limits(type(self._teacher), self._name, self.space)
        self._answers: dict[str, Callable[..., Any] | None]
        self._answers = {"values": values, "act": act, "evaluate": evaluate}
        self._check_needs()
        level = effective_level(type(self._teacher), self._name, KnowledgeLevel(expert_knowledge))
        placement, teaching = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(2))
        knowledge = knowledge_of(level, self.space, placement, easy_task, mastery_return)
        knowledge = replace(
            knowledge, initial=initial or knowledge.initial, target=target or knowledge.target
        )
        self._teacher.start(self.space, knowledge, teaching)
        self._checked = CheckedTeacher(self._teacher, self._name)
        # assignments of running episodes, with the attributes set by the teacher's `sample`
        self._open: dict[int, tuple[Assignment, dict[str, Any]]] = {}
        self._assigned = 0
        self._rows: list[EpisodeRow] = []
        self._log: list[dict[str, object]] = []
        self._prepare()

    def _prepare(self) -> None:
        """Initialise the attributes that belong to this process and are not saved."""
        self._lock, self._process = RLock(), os.getpid()
        self._server: CurriculumServer | None = None

    @property
    def episodes(self) -> pd.DataFrame:
        """Table of the reported episodes, with one column per task dimension, such as "task_mass"."""
        tasks = [f"task_{name}" for name in self.space.names]
        columns = ["episode", "step", *tasks, "episodic_return", "length", "success", "trains"]
        with self._lock:
            rows = [
                (index, step, *map(float, task), *outcome)
                for index, (step, task, *outcome) in enumerate(self._rows)
            ]
        return pd.DataFrame(rows, columns=columns)

    def wrap(self, environment: Environment, apply: Apply | None = None) -> CurriculumEnvironment:
        """Wrap `environment` so that each episode takes its task from the curriculum.

        Args:
            environment: environment whose `reset` takes ``options={"task": …}``, unless `apply` is given.
            apply: function (environment, task by name) that prepares any environment for a task, before each
                `reset`.
        """
        return CurriculumEnvironment(environment, self, apply)

    def wrap_vector(
        self, worlds: VectorEnv[Any, Any, Any], apply: Apply | None = None
    ) -> VectorEnv[Any, Any, Any]:
        """Wrap a vector environment of any autoreset mode so that episodes take tasks from the curriculum.

        Args:
            worlds: vector environment of the benchmark, made with `gymnasium.make_vec`; a `SyncVectorEnv`,
                whose environments are wrapped in place; or an `AsyncVectorEnv`, which is closed and
                restarted. In the mode SAME_STEP, the benchmark's environments take the next task before the
                teacher observes the episode that ends in the step.
            apply: function as for `wrap`.

        Raises:
            TypeError: if the vector environment is of another type; see `shared`.
            ValueError: if the teacher cannot teach several environments at once.
        """
        if worlds.num_envs > 1 and not self._teacher.overlapping:
            raise ValueError(f"num_envs = {worlds.num_envs}: expected 1, {self._needs_one_world()}")
        if isinstance(worlds, AsyncVectorEnv):
            return restarted(worlds, self.shared(), apply)
        return wrap_vector(worlds, self, apply)

    def shared(self, host: str | None = None) -> SharedCurriculum:
        """Return a picklable handle of the curriculum for use in other processes.

        Args:
            host: name or address of this machine for other machines; None for this machine only. Only the
                first call has an effect.
        """
        self._check_process()
        with self._lock:
            if self._server is None:
                self._server = CurriculumServer(self, host)
        settings = self.space, self.gamma, self.mastery_return, self.marks_withheld
        return SharedCurriculum(self._server.address, self._server.key, *settings)

    def begin(self) -> Assignment:
        """Start the next episode and return its assignment, for loops without a wrapper.

        Raises:
            ValueError: if an episode is under way, and the teacher does not support overlapping ones.
        """
        self._check_process()
        with self._lock:
            if self._open and not self._teacher.overlapping:
                raise ValueError(f"an episode is under way: end or abandon it, {self._needs_one_world()}")
            proposal = self._checked.propose()
            records = self._teacher.wants_trajectory
            assignment = Assignment(self._assigned, proposal.task, proposal.trains, records)
            state = {name: getattr(self._teacher, name) for name in self._teacher.episode_state}
            self._open[self._assigned] = assignment, state
            self._assigned += 1
            self._drain()
            return assignment

    def end(self, played: PlayedEpisode) -> None:
        """Report an episode to the teacher, and answer the teacher's queries.

        Raises:
            ValueError: if the episode is not under way.
        """
        with self._lock:
            if played.number not in self._open:
                raise ValueError(f"episode {played.number} is not under way: report each once")
            assignment, state = self._open.pop(played.number)
            vars(self._teacher).update(state)
            self.steps += played.length
            episode = Episode(
                task=assignment.task,
                episodic_return=played.episodic_return,
                success=played.episodic_return > self.mastery_return,
                length=played.length,
                initial_observation=played.initial_observation,
                discounted_return=played.discounted_return,
                step=self.steps,
                trains=assignment.trains,
            )
            self._rows.append(EpisodeRow.of(episode))
            query = self._checked.observe(episode)
            while query is not None:
                query = self._checked.answer(self._answer(query, played.trajectory))
            self._drain()

    def abandon(self, number: int) -> None:
        """Discard the episode `number` without reporting it."""
        with self._lock:
            self._open.pop(number, None)

    def act(self, observations: Array) -> Array:
        """Return actions (n, a) of the exploring policy for observations (n, o)."""
        return np.asarray(self._function("act", "proposed an episode that must not train")(observations))

    def probe(self, count: int) -> Task:
        """Return tasks (count, d) of the teacher without exploration, leaving its state unchanged."""
        with self._lock:
            return self._checked.probe(count)

    def save(self, folder: str | Path) -> None:
        """Save the curriculum, without episodes under way, and a record of it as a results root.

        A curriculum saved earlier in the folder is replaced.

        Raises:
            FileExistsError: if the folder has other contents.
        """
        with self._lock:
            self._check_process()
            state = {name: value for name, value in vars(self).items() if name not in _UNSAVED}
            write_record(Path(folder), self, STATE, pickle.dumps(state))

    @classmethod
    def load(
        cls,
        folder: str | Path,
        *,
        values: Values | None = None,
        act: Act | None = None,
        evaluate: Evaluate | None = None,
    ) -> "Curriculum":
        """Load a curriculum written by `save`; it continues bit for bit.

        The file is a pickle: load only files that you trust. The functions are not saved; see the class.
        """
        loaded = cls.__new__(cls)
        vars(loaded).update(pickle.loads((Path(folder) / STATE).read_bytes()))
        loaded._answers = {"values": values, "act": act, "evaluate": evaluate}
        loaded._check_needs()
        loaded._checked, loaded._open = CheckedTeacher(loaded._teacher, loaded._name), {}
        loaded._prepare()
        return loaded

    def __reduce__(self) -> tuple[Any, ...]:
        return self.shared().__reduce__()

    def _check_process(self) -> None:
        if os.getpid() != self._process:
            raise RuntimeError(
                "this process has a forked copy of the curriculum, which would teach alone: use the handle "
                "that curriculum.shared() returns, made before the fork"
            )

    def _check_needs(self) -> None:
        needs = [name for name in needs_of(type(self._teacher)) if name != "act" or not self.marks_withheld]
        missing = [f"{name}=" for name in needs if self._answers[name] is None]
        if missing:
            instead = " (or marks_withheld=True)" if "act=" in missing else ""
            undemanding = [name for name in TEACHERS.names() if not needs_of(TEACHERS.get(name))]
            raise ValueError(
                f"teacher {self._name!r} needs {', '.join(missing)}{instead}: see Curriculum; teachers "
                f"without such needs: {', '.join(undemanding)}"
            )

    def _needs_one_world(self) -> str:
        return (
            f"since teacher {self._name!r} proposes the next task after the end of the last episode; choose "
            f"a teacher with several_worlds in teacher_needs()"
        )

    def _function(self, name: str, reason: str) -> Callable[..., Any]:
        function = self._answers[name]
        if function is None:
            raise ValueError(f"teacher {self._name!r} {reason}: give {name}= to its Curriculum")
        return function

    def _answer(self, query: Query, trajectory: Trajectory | None) -> Answer:
        if query.kind is QueryKind.TRAJECTORY:
            if trajectory is None:
                raise ValueError(
                    f"teacher {self._name!r} asked for a trajectory that was not recorded: declare "
                    f"wants_trajectory = True in its class"
                )
            return trajectory
        if query.kind is QueryKind.EVALUATION:
            evaluate = self._function("evaluate", "asked for an evaluation")
            outcomes: Outcomes = evaluate(query.tasks, query.greedy)
            self.steps += int(outcomes.lengths.sum())
            return outcomes
        assert query.observations is not None, "a query for values holds observations"
        values = self._function("values", "asked for values of states")(query.observations)
        answer = np.asarray(values, dtype=np.float64)
        if answer.shape != (len(query.observations),) or not np.isfinite(answer).all():
            raise ValueError(
                f"values= returned shape {answer.shape} for {len(query.observations)} observations: expected "
                f"one finite number each"
            )
        return answer

    def _drain(self) -> None:
        updates = self._teacher.drain_updates()
        self._log += [teacher_log_row(self.steps, len(self._rows), update) for update in updates]


_UNSAVED = ("_answers", "_checked", "_open", "_lock", "_process", "_server")


def _task_space(space: Space) -> TaskSpace:
    if isinstance(space, TaskSpace):
        return space
    if isinstance(space, Mapping):
        return TaskSpace.from_bounds(dict(space))
    declared = space.get_wrapper_attr("task_space") if hasattr(space, "get_wrapper_attr") else None
    if not isinstance(declared, TaskSpace):
        raise TypeError(
            f"space = {space!r:.60}: expected a TaskSpace, a dict of names to bounds, or an environment with "
            f"a task_space"
        )
    return declared


def _new_teacher(teacher: str | type[Teacher] | Teacher) -> tuple[Teacher, str]:
    """Return a new teacher, not yet started, and its name."""
    if isinstance(teacher, str):
        return make_teacher(teacher), teacher
    if isinstance(teacher, type) and issubclass(teacher, Teacher):
        return teacher(), teacher.__name__
    if isinstance(teacher, Teacher):
        return copy.deepcopy(teacher), type(teacher).__name__
    raise TypeError(f"teacher = {teacher!r:.60}: expected a name, a class or an instance of Teacher")

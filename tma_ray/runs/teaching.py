"""Link between a run and its teacher, which may be in another process."""

import copy
import pickle
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from tma_ray.runs.inputs import arguments, import_plugins
from tma_ray.runs.spec import RunSpec, Streams, placement_generator, task_space_shuffle
from tma_ray.support.component_names import base_name
from tma_ray.tasks import (
    Answer,
    Episode,
    Proposal,
    Query,
    QueryKind,
    Task,
    TeacherUpdate,
    expert_knowledge,
)
from tma_ray.teachers import Teacher, make_teacher


@dataclass(frozen=True)
class Reply:
    """A teacher's reply to an episode: the next task, or a query to be answered first.

    Attributes:
        task: next task float32 (d,), None with a query.
        query: query to answer first, or None.
        updates: log entries since the last reply.
        wants_trajectory: True if the teacher needs the next episode's trajectory.
        trains: True if the student learns from the next episode.
    """

    task: Task | None
    query: Query | None
    updates: tuple[TeacherUpdate, ...]
    wants_trajectory: bool
    trains: bool = True


class TeacherLink(Protocol):
    """Interface between a run and its teacher, which may be in another process."""

    def exchange(self, episode: Episode | None) -> Reply:
        """Report a finished episode (None before the first) and return the teacher's reply."""

    def answer(self, answer: Answer) -> Reply:
        """Pass on the answer to the teacher's last query, and return the teacher's next reply."""

    def probe(self, count: int) -> Task:
        """Return tasks (count, d) without exploration or side effects."""

    def save(self) -> bytes:
        """Return the teacher's complete state."""

    def load(self, state: bytes) -> None:
        """Restore a state that `save` returned."""


def _can_be_pickled(value: object) -> bool:
    try:
        pickle.dumps(copy.deepcopy(value))
    except (TypeError, AttributeError, pickle.PicklingError):
        return False
    return True


class CheckedTeacher:
    """Wrapper around a started teacher that checks its tasks and queries.

    Every method raises a ValueError if the teacher returns anything that its class does not declare.

    Args:
        teacher: teacher after `start`.
        name: name of the teacher, for messages.
    """

    def __init__(self, teacher: Teacher, name: str) -> None:
        self._teacher, self._name = teacher, name

    def propose(self) -> Proposal:
        """Return the teacher's next proposal."""
        proposal = self._teacher.propose()
        self._check(proposal.task, (self._teacher.space.size,))
        return proposal

    def observe(self, episode: Episode) -> Query | None:
        """Report a finished episode, and return the teacher's query, if any."""
        return self._checked(self._teacher.observe(episode))

    def answer(self, answer: Answer) -> Query | None:
        """Pass on the answer to the teacher's last query, and return the teacher's next query, if any."""
        return self._checked(self._teacher.answer(answer))

    def probe(self, count: int) -> Task:
        """Return tasks (count, d) without exploration or side effects."""
        tasks = self._teacher.probe(count)
        self._check(tasks, (count, self._teacher.space.size))
        return tasks

    def _checked(self, query: Query | None) -> Query | None:
        if query is not None and query.kind is QueryKind.EVALUATION:
            if not self._teacher.wants_evaluations:
                raise ValueError(
                    f"teacher {self._name!r} asked for an evaluation: declare wants_evaluations = True in "
                    f"its class"
                )
            assert query.tasks is not None, "a query for an evaluation holds tasks"
            self._check(query.tasks, (max(len(query.tasks), 1), self._teacher.space.size))
        return query

    def _check(self, tasks: Any, shape: tuple[int, ...]) -> None:
        if not isinstance(tasks, np.ndarray) or tasks.shape != shape or tasks.dtype != np.float32:
            actual = f"{tasks.dtype} {tasks.shape}" if isinstance(tasks, np.ndarray) else repr(tasks)
            raise ValueError(f"teacher {self._name!r} gave {actual}; expected float32 tasks of shape {shape}")
        space = self._teacher.space
        if not space.contains(tasks):
            raise ValueError(
                f"teacher {self._name!r} left its task space with {tasks.tolist()}: bounds are "
                f"{space.low.tolist()} to {space.high.tolist()}; clip with space.clip"
            )


class InlineTeacher:
    """Link to a run's teacher in this process.

    Raises:
        ValueError: if the teacher refuses a hyper-parameter, or its source differs from the planned one.
    """

    def __init__(self, spec: RunSpec) -> None:
        import_plugins(spec, "teacher")
        self._teacher = make_teacher(base_name(spec.teacher), arguments(spec, "teacher"))
        placement = placement_generator(spec)
        landscape = task_space_shuffle(spec, placement)  # must be the first draw from `placement`
        knowledge = expert_knowledge(
            spec.expert_knowledge,
            spec.task_space,
            placement,
            spec.easy_task,
            spec.mastery_threshold,
            landscape,
        )
        self._teacher.start(spec.task_space, knowledge, np.random.default_rng(Streams.of(spec).teacher))
        self._name = spec.teacher
        self._checked = CheckedTeacher(self._teacher, spec.teacher)

    def exchange(self, episode: Episode | None) -> Reply:
        """Report a finished episode (None before the first) and return the teacher's reply.

        Raises:
            ValueError: if the teacher proposes a task outside its space.
        """
        query = None if episode is None else self._checked.observe(episode)
        return self._reply(query)

    def answer(self, answer: Answer) -> Reply:
        """Pass on the answer to the teacher's last query, and return the teacher's next reply."""
        return self._reply(self._checked.answer(answer))

    def probe(self, count: int) -> Task:
        """Return tasks (count, d) without exploration or side effects."""
        return self._checked.probe(count)

    def save(self) -> bytes:
        """Return the teacher's complete state.

        Raises:
            ValueError: if an attribute cannot be pickled.
        """
        try:
            return pickle.dumps(self._teacher.state())
        except (TypeError, AttributeError, pickle.PicklingError) as error:
            learned = {name: value for name, value in vars(self._teacher).items() if name.endswith("_")}
            names = ", ".join(name for name, value in learned.items() if not _can_be_pickled(value))
            raise ValueError(
                f"teacher {self._name!r}: what it learned cannot be pickled for a checkpoint: "
                f"{names or 'its state'} ({error}); keep it in another form, or under a name without an "
                f"underscore at its end if it need not be saved"
            ) from error

    def load(self, state: bytes) -> None:
        """Restore a state that `save` returned."""
        self._teacher.load_state(pickle.loads(state))

    def _reply(self, query: Query | None) -> Reply:
        task, trains = None, True
        if query is None:
            proposal = self._checked.propose()
            task, trains = proposal.task, proposal.trains
        updates = tuple(self._teacher.drain_updates())
        return Reply(task, query, updates, self._teacher.wants_trajectory, trains)

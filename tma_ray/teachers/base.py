"""Base classes of teachers, which propose tasks, observe episodes and may make queries."""

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from tma_ray.tasks import (
    Episode,
    ExpertKnowledge,
    KnowledgeLevel,
    Proposal,
    Query,
    Task,
    TaskSpace,
    TeacherUpdate,
)

PAPER_BUDGET = 20_000_000  # budget, in environment steps, to which default sizes and intervals apply


def for_budget(size: int, budget: int) -> int:
    """Scale a buffer size, delay or interval from the paper's budget to `budget` environment steps.

    The scale is the square root: a hundredth of the budget has a tenth of the refreshes, each from a tenth of
    the episodes.

    Raises:
        ValueError: if `budget` is under 1.
    """
    if budget < 1:
        raise ValueError(f"budget = {budget}: expected at least 1 environment step")
    return max(1, round(size * math.sqrt(budget / PAPER_BUDGET)))


def next_due(due: int, every: int, step: int) -> int:
    """Return the first of `due`, `due` + `every`, ... greater than `step`, which is at least `due`."""
    return due + every * ((step - due) // every + 1)


@dataclass
class Teacher(ABC):
    """Base class of teachers, automatic curriculum learning algorithms.

    Subclasses are dataclasses whose fields are hyper-parameters. Learned attributes have names that end in an
    underscore; these and the generator are the teacher's complete state.

    The run calls `start` once, then in turn `sample`, `observe` and, while that returns a query, `answer`.
    Between episodes it may call `probe`.

    Attributes:
        algorithm_version: part of the identity of every run, increased with each change that gives other
            tasks; None for a plug-in, which is identified by its source.
        knowledge_levels: levels of expert knowledge that make a difference to the teacher, in increasing
            order. It needs at least the first. At a level that is not listed it behaves as at the next lower
            one, so that such runs are shared.
        absent_at_default: hyper-parameters added after the first runs, whose defaults are not part of a run's
            identity: see `tma_ray.components.settings.config_dict`.
        presets: groups of hyper-parameters by their name in ``preset=``.
        wants_trajectory: True if it may query trajectories, which are recorded for such teachers only.
        wants_evaluations: True if it may propose episodes from which the student does not learn, or query
            evaluations; it requires students that can play without learning.
        wants_values: True if it may query values of states.
        withholds_episodes: True if it may propose episodes from which the student does not learn.
        overlapping: True if it may propose a task while earlier episodes are under way.
        episode_state: learned attributes that `sample` sets for its episode and `observe` reads; a loop with
            overlapping episodes restores them before `observe`.
        most_dimensions: largest number of dimensions of a task space; None for any number.
        constant_dimensions: True if a dimension of the task space may be constant.
        single_task: True if all dimensions of the task space may be constant.
        space: task space.
        knowledge: expert knowledge of the task space.
        rng: only source of randomness.
    """

    algorithm_version: ClassVar[int | None] = None
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.NONE,)
    absent_at_default: ClassVar[frozenset[str]] = frozenset()
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    wants_trajectory: ClassVar[bool] = False
    wants_evaluations: ClassVar[bool] = False
    wants_values: ClassVar[bool] = False
    withholds_episodes: ClassVar[bool] = False
    overlapping: ClassVar[bool] = False
    episode_state: ClassVar[tuple[str, ...]] = ()
    most_dimensions: ClassVar[int | None] = None
    constant_dimensions: ClassVar[bool] = True
    single_task: ClassVar[bool] = True

    space: TaskSpace = field(init=False, repr=False)
    knowledge: ExpertKnowledge = field(init=False, repr=False)
    rng: np.random.Generator = field(init=False, repr=False)

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Prepare for a new run; overriding methods must call this one first."""
        self.space, self.knowledge, self.rng = space, knowledge, rng
        self._updates: list[TeacherUpdate] = []

    @classmethod
    def refusal(cls, space: TaskSpace) -> str:
        """Return the reason why the teacher cannot use `space`, or an empty string."""
        if cls.most_dimensions is not None and space.size > cls.most_dimensions:
            return f"{cls.__name__} teaches in {cls.most_dimensions} dimensions at most, not {space.size}"
        if not cls.constant_dimensions and (space.width == 0).any():
            return f"{cls.__name__} does not teach in spaces with a constant dimension"
        if not cls.single_task and not (space.width > 0).any():
            return (
                f"{cls.__name__} does not teach in a space of a single task, where there is nothing to choose"
            )
        return ""

    @abstractmethod
    def sample(self) -> Task | Proposal:
        """Return the next task, float32 (d,) in the space, or a `Proposal` if the student must not learn."""

    def propose(self) -> Proposal:
        """Return the result of `sample` as a proposal; called by the training loop.

        Raises:
            ValueError: if a teacher without `wants_evaluations` proposes an episode without learning.
        """
        sampled = self.sample()
        proposal = sampled if isinstance(sampled, Proposal) else Proposal(sampled)
        if not proposal.trains and not self.wants_evaluations:
            raise ValueError(
                f"{type(self).__name__} proposed an episode from which the student does not learn: declare "
                f"wants_evaluations = True in its class"
            )
        return proposal

    def observe(self, episode: Episode) -> Query | None:  # noqa: B027 - not learning is a fair default
        """Learn from a finished episode, and return a query if one is needed."""

    def answer(self, answer: Any) -> Query | None:
        """Receive the `Answer` to the last query, and return another query if one is needed."""
        raise TypeError(
            f"{type(self).__name__} asked a query and was given {type(answer).__name__}, "
            f"but does not define answer(answer)"
        )

    def probe(self, count: int) -> Task:
        """Return `count` tasks (count, d) without exploration, leaving the state unchanged.

        By default, these are samples of a copy of the teacher.
        """
        twin = copy.deepcopy(self)
        twin.rng = self.probe_rng()
        return np.stack([twin.propose().task for _ in range(count)])

    def probe_rng(self) -> np.random.Generator:
        """Return a generator for probes, derived from `rng` without advancing it."""
        bit_generator = copy.deepcopy(self.rng.bit_generator)
        assert isinstance(bit_generator, np.random.PCG64)
        return np.random.Generator(bit_generator.jumped())

    def log(self, update: TeacherUpdate) -> None:
        """Record an update of the task distribution for the table `teacher_log`."""
        self._updates.append(update)

    def drain_updates(self) -> list[TeacherUpdate]:
        """Return the updates logged since the last call."""
        updates, self._updates = self._updates, []
        return updates

    def state(self) -> dict[str, Any]:
        """Return the complete state, for `load_state` in another process."""
        learned = {name: value for name, value in vars(self).items() if name.endswith("_")}
        return copy.deepcopy({"learned": learned, "rng": self.rng.bit_generator.state})

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore a state returned by `state`; call `start` with the same space and knowledge first."""
        state = copy.deepcopy(state)
        vars(self).update(state["learned"])
        self._updates = []  # those logged by `start` are already in the table
        self.rng.bit_generator.state = state["rng"]


@dataclass
class DistributionTeacher(Teacher):
    """Base class of teachers that sample tasks from a current distribution."""

    @abstractmethod
    def draw(self, rng: np.random.Generator, count: int) -> Task:
        """Return `count` tasks (count, d) drawn from the current distribution."""

    def sample(self) -> Task:
        """Return a task (d,) drawn from the current distribution."""
        task: Task = self.draw(self.rng, 1)[0]
        return task

    def probe(self, count: int) -> Task:
        """Return `count` tasks (count, d) drawn from the current distribution."""
        return self.draw(self.probe_rng(), count)

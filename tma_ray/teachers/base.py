"""The protocol of a teacher: it proposes tasks, observes episodes, and may ask questions."""

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

PAPER_STEPS = 20_000_000
"""Budget, in environment steps, for which buffers, waits and intervals between refreshes are given."""


def for_budget(size: int, budget: int) -> int:
    """Return the size of a buffer, a wait or an interval in a run of `budget` environment steps.

    `size` is that of the paper's budget. It is scaled by the square root: a hundredth of the budget has a
    tenth of the refreshes, each from a tenth of the episodes.

    Raises:
        ValueError: `budget` is under 1.
    """
    if budget < 1:
        raise ValueError(f"budget = {budget}: expected at least 1 environment step")
    return max(1, round(size * math.sqrt(budget / PAPER_STEPS)))


def next_due(due: int, every: int, step: int) -> int:
    """Return the first of the steps `due`, `due` + `every`, ... after `step`, which is at least `due`."""
    return due + every * ((step - due) // every + 1)


@dataclass
class Teacher(ABC):
    """An automatic curriculum learning algorithm.

    Subclasses are dataclasses whose fields are hyper-parameters. What they learn goes into attributes
    whose names end in an underscore: these, and the generator, are the teacher's complete state.

    The run calls `start` once, then in turn `sample`, `observe` and, if that returned a query,
    `answer`, until it has none left. Between episodes it may call `probe`.

    Attributes:
        algorithm_version: part of the identity of every run: raised with each change that gives other
            tasks. None for a plug-in that is told apart by its source alone.
        knowledge_levels: the levels of expert knowledge that make a difference to the teacher, in
            rising order. It needs at least the first; at a level that is not listed it behaves as at
            the next lower one that is, so that such runs are shared instead of repeated.
        absent_at_default: hyper-parameters that came after the first runs, whose identity they leave as it
            was: see `tma_ray.components.settings.config_dict`.
        presets: hyper-parameters that belong together, by the name that ``preset=`` chooses them with.
        wants_trajectory: True if it may ask for trajectories; for others the run does not record them.
        wants_evaluations: True if it may propose episodes from which the student does not learn, or ask for
            evaluations of tasks; it runs only with students that can play without learning.
        wants_values: True if it may query values of states.
        withholds_episodes: True if it may propose episodes from which the student does not learn.
        overlapping: True if it may propose a task while episodes of earlier ones are under way.
        episode_state: learned attributes that `sample` sets for its episode and `observe` reads; a loop with
            overlapping episodes restores them before `observe`.
        most_dimensions: dimensions of a task space up to which it can teach; None for any number.
        constant_dimensions: True if it can teach in a space one of whose dimensions has a single value.
        single_task: True if it can teach in a space all of whose dimensions have a single value.
        space: the box to choose tasks from.
        knowledge: expert knowledge of the task space.
        rng: the only source of randomness.
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
        """Prepare for a new run; overriding methods call this one first."""
        self.space, self.knowledge, self.rng = space, knowledge, rng
        self._updates: list[TeacherUpdate] = []

    @classmethod
    def refusal(cls, space: TaskSpace) -> str:
        """Return the reason why a task space exceeds the teacher's declared limits; empty if it does not."""
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
        """Return the next task, float32 (d,) inside the space; as a `Proposal`, if it is not to train."""

    def propose(self) -> Proposal:
        """Return the task of `sample` as a proposal; the loop that drives a teacher calls this method.

        Raises:
            ValueError: an episode without learning from a teacher that does not declare `wants_evaluations`.
        """
        sampled = self.sample()
        proposal = sampled if isinstance(sampled, Proposal) else Proposal(sampled)
        if not proposal.trains and not self.wants_evaluations:
            raise ValueError(
                f"{type(self).__name__} proposed an episode from which the student does not learn: declare "
                f"wants_evaluations = True in its class"
            )
        return proposal

    def observe(self, episode: Episode) -> Query | None:  # noqa: B027 - hearing nothing is a fair default
        """Learn from a finished episode; return a query if it needs more to do so."""

    def answer(self, answer: Any) -> Query | None:
        """Receive the `Answer` to the last query, of the type of its kind; may return a further query."""
        raise TypeError(
            f"{type(self).__name__} asked a query and was given {type(answer).__name__}, "
            f"but does not define answer(answer)"
        )

    def probe(self, count: int) -> Task:
        """Return `count` tasks (count, d) without exploration, and leave no trace.

        By default these are samples of a copy of the teacher.
        """
        twin = copy.deepcopy(self)
        twin.rng = self.probe_rng()
        return np.stack([twin.propose().task for _ in range(count)])

    def probe_rng(self) -> np.random.Generator:
        """Return a generator for probes, derived from the state of `rng` without changing it."""
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
        """Return everything learned, to be continued exactly by `load_state` in another process."""
        learned = {name: value for name, value in vars(self).items() if name.endswith("_")}
        return copy.deepcopy({"learned": learned, "rng": self.rng.bit_generator.state})

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore a state that `state` returned, after `start` with the same space and knowledge."""
        state = copy.deepcopy(state)
        vars(self).update(state["learned"])
        self._updates = []  # what `start` logged was drained before this state was saved
        self.rng.bit_generator.state = state["rng"]

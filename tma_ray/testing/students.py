"""Simulated students: learners given by a few equations, for trying out teachers without physics.

A task makes demands q in [0, 1]^d on the student: 0 is the easiest value of each dimension, 1 the hardest.
The space of demands is cut into regions with centres c_i, and the student has a competence k_i in [0, 1] in
each. With the kernel K_i(q) = exp(-|q - c_i|^2 / 2 ell^2) its competence at a task is the kernel average

    k(q) = sum_i K_i(q) k_i / sum_i K_i(q),        0 where the task is unfeasible,

from which its episodic return follows, R = -100 + 400 k(q) + noise. An episode teaches and time erodes:

    k_i <- (1 - phi) (k_i + eta (1 - D_i / L) r(q) K_i(q) (1 - k_i)),        r(q) = k(max(q - zone, 0)),

- r, *readiness*: a task teaches as far as the student masters those that are a little easier in every
  dimension: learning happens in the zone of proximal development (Vygotsky 1978), beyond which it is nothing;
  what lies within one zone of the easiest task needs no preparation (r = 1). It is a smooth form of the toy
  spaces of Portelas et al. 2019, whose hypercubes are locked until a neighbour has been trained enough;
- K_i: experience carries to similar tasks and no further (gradients of generalisation, Shepard 1987);
- 1 - k_i: learning slows down, and mastered tasks teach nothing (exponential curves, Heathcote et al. 2000);
- 1 - D_i / L: the closer a region's difficulty D_i, the mean of its demands, is to the student's limit L,
  the slower it is learned; beyond L, or where a demand is over 1, tasks are unfeasible;
- phi: what is not practised fades exponentially (after Ebbinghaus 1885), everywhere and in every episode.

What it leaves out: returns do not depend on the world drawn for a task, learning has no plateaus, and every
episode is equally long.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.benchmark import find_challenge, load_test_set
from tma_ray.support.validation import check_fields, check_known
from tma_ray.tasks import Answer, Episode, Outcomes, QueryKind, Task, TaskSpace, TestSet, Trajectory
from tma_ray.teachers import Teacher

DISCOUNT = 0.99  # gamma of simulated students; rewards come evenly over an episode

StateValues = Callable[[NDArray[np.float32]], NDArray[np.float64]]
"""Return values (n,) of observations (n, o)."""

Evaluate = Callable[[Task, bool], Outcomes]
"""Return the outcomes of tasks (n, d); the second argument asks for the deterministic policy."""


def report_episode(teacher: Teacher, episode: Episode, state_values: StateValues, evaluate: Evaluate) -> None:
    """Tell `teacher` of `episode` and answer what it asks.

    Raises:
        ValueError: it asks for a trajectory or an evaluation without having declared that it wants any.
    """
    query = teacher.observe(episode)
    while query is not None:
        answer: Answer
        wanted = "wants_trajectory" if query.kind is QueryKind.TRAJECTORY else "wants_evaluations"
        if query.kind is QueryKind.STATE_VALUES:
            assert query.observations is not None, "a query for values holds observations"
            answer = state_values(query.observations)
        elif not getattr(teacher, wanted):
            raise ValueError(
                f"{type(teacher).__name__} made a query of the kind {query.kind.value!r}: declare "
                f"{wanted} = True in its class"
            )
        elif query.kind is QueryKind.TRAJECTORY:  # nothing changes, and rewards come evenly
            observations = np.tile(episode.initial_observation, (episode.length + 1, 1))
            rewards = np.full(episode.length, episode.episodic_return / episode.length)
            actions = np.zeros((episode.length, 1), np.float32)
            answer = Trajectory(observations, actions, rewards, terminated=False, gamma=DISCOUNT)
        else:
            assert query.tasks is not None, "a query for an evaluation holds tasks"
            answer = evaluate(query.tasks, query.greedy)
        query = teacher.answer(answer)


Array = NDArray[np.float64]

SIMULATION_VERSION = 1
"""Version of the equations and their parameters, part of every simulated run; raise it when these change."""

WORST_RETURN = -100.0  # expected return without any competence: a walker that falls at once
RETURN_RANGE = 400.0  # what full competence adds; mastery, a return over 230, takes a competence over 0.825

STEADY_SPREAD = 0.02
"""Standard deviation of an episode's competence around the student's at a hopeless or a mastered task: 8
units of return, as random walkers vary (docs/fidelity.md)."""

UNSTEADY_SPREAD = 0.4  # times k (1 - k) added to it: who half masters a task now falls, now arrives

EPISODE_STEPS = 2_000
"""Environment steps of every simulated episode, the time limit of Stump Tracks: 10,000 episodes are the
paper's 20 million steps, and teachers that count steps update as often as they would there."""

DISCOUNTED_SHARE = (1 - DISCOUNT**EPISODE_STEPS) / (1 - DISCOUNT) / EPISODE_STEPS
"""Discounted return of an episode that returns 1 in all: about 1/20."""

MOST_REGIONS = 10_000  # regions that a student may have in all, so that an episode costs tens of microseconds


@dataclass(frozen=True)
class StudentParameters:
    """Parameters of one simulated student; symbols as in the module's equations.

    The defaults were fixed by looking at Random alone on the original challenge: it should master a middling
    share of the test tasks in 10,000 episodes, and still be learning at their end. No other teacher was run
    before, and none changed them.

    Attributes:
        pace: eta, share of what is missing that a perfectly prepared episode on an easy task teaches.
        pace_spread: standard deviation of the logarithm of a factor on `pace` that each student draws when it
            is made, since no two training runs go alike.
        zone: width of the zone of proximal development, in demands.
        reach: ell, distance over which experience carries, in regions.
        forgetting: phi, share of competence lost per episode.
        limit: L, difficulty over which tasks are unfeasible.
        regions: per dimension; over all dimensions at most 10,000.
    """

    pace: float = 0.06
    pace_spread: float = 0.25
    zone: float = 0.1
    reach: float = 0.7
    forgetting: float = 5e-5
    limit: float = 0.6
    regions: int = 10

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("pace", "zone", "reach", "limit", "regions"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} = {getattr(self, name)}: expected a positive number")
        if self.pace_spread < 0:
            raise ValueError(f"pace_spread = {self.pace_spread}: expected a number of at least 0")
        if not 0 <= self.forgetting < 1:
            raise ValueError(f"forgetting = {self.forgetting}: expected a share in [0, 1)")


class SimulatedStudent:
    """A learner without physics, trained one task at a time.

    Args:
        easy: the easiest task (d,); what is easier still counts as this.
        hard: the hardest task (d,) that could be feasible, different from `easy` in every dimension.
        rng: source of the student's own pace, then the noise of returns.
        aptitude: speed of learning.

    Raises:
        ValueError: shapes that do not fit, a dimension without width, or too many regions.
    """

    def __init__(
        self,
        easy: ArrayLike,
        hard: ArrayLike,
        rng: np.random.Generator,
        aptitude: StudentParameters | None = None,
    ) -> None:
        self.aptitude = aptitude = aptitude or StudentParameters()
        self._easy, self._hard = np.asarray(easy, dtype=np.float64), np.asarray(hard, dtype=np.float64)
        if self._easy.ndim != 1 or self._easy.shape != self._hard.shape or np.any(self._easy == self._hard):
            raise ValueError(
                f"easy {self._easy} and hard {self._hard}: expected two tasks that differ in every dimension"
            )
        if aptitude.regions**self._easy.size > MOST_REGIONS:
            raise ValueError(
                f"regions = {aptitude.regions} in each of {self._easy.size} dimensions are over "
                f"{MOST_REGIONS:,} in all; choose fewer"
            )
        self._rng = rng
        self._axis = (np.arange(aptitude.regions) + 0.5) / aptitude.regions
        self._precision = -0.5 * (aptitude.regions / aptitude.reach) ** 2
        difficulty = np.stack(np.meshgrid(*[self._axis] * self._easy.size, indexing="ij")).mean(axis=0)
        pace = min(aptitude.pace * float(np.exp(aptitude.pace_spread * rng.standard_normal())), 1.0)
        self._pace = pace * np.maximum(1 - difficulty / aptitude.limit, 0.0)
        self.reset()

    def reset(self) -> None:
        """Forget everything: an untrained student again."""
        self._competence = np.zeros_like(self._pace)

    def play(self, task: ArrayLike, trains: bool = True) -> float:
        """Play one episode of `task` (d,), learn from it if it `trains`, and return its episodic return.

        Without learning nothing is forgotten either.
        """
        demands = self.initial_observations(task).astype(np.float64)
        competence = 0.0
        if self._feasible(demands):
            before = demands - self.aptitude.zone
            kernels = self._kernels(np.stack([demands, np.maximum(before, 0.0)]))
            competence, readiness = self._read(kernels)
            if np.all(before <= 0):
                readiness = 1.0
            if trains:
                self._learn(readiness, kernels[:, 0])
        if trains:
            self._competence *= 1 - self.aptitude.forgetting
        spread = STEADY_SPREAD + UNSTEADY_SPREAD * competence * (1 - competence)
        return WORST_RETURN + RETURN_RANGE * (competence + spread * float(self._rng.standard_normal()))

    def initial_observations(self, tasks: ArrayLike) -> NDArray[np.float32]:
        """Return the initial observations (..., d) of `tasks` (..., d): their demands.

        They tell more than the lidars of a walker would, so that teachers which ask for values get all that
        there is to know.
        """
        demands = (np.asarray(tasks, dtype=np.float64) - self._easy) / (self._hard - self._easy)
        return np.maximum(demands, 0.0).astype(np.float32)

    def expected_returns(self, tasks: ArrayLike) -> Array:
        """Return the expected episodic returns (n,) of `tasks` (n, d), from which nothing is learned."""
        return self._expected(self.initial_observations(tasks))

    def state_values(self, observations: NDArray[np.float32]) -> Array:
        """Return the expected discounted returns (n,) of initial observations (n, d), which never change."""
        if (observations == observations[0]).all():  # a trajectory
            return np.repeat(DISCOUNTED_SHARE * self._expected(observations[:1]), len(observations))
        return DISCOUNTED_SHARE * self._expected(observations)

    def _expected(self, observations: NDArray[np.float32]) -> Array:
        demands = observations.astype(np.float64)
        competence = np.where(self._feasible(demands), self._read(self._kernels(demands)), 0.0)
        return WORST_RETURN + RETURN_RANGE * competence

    def _feasible(self, demands: Array) -> NDArray[np.bool_]:
        feasible: NDArray[np.bool_] = (demands.max(-1) <= 1) & (demands.mean(-1) <= self.aptitude.limit)
        return feasible

    def _kernels(self, demands: Array) -> Array:
        """Factors (d, n, regions) of the kernel, which is a product over dimensions."""
        kernels: Array = np.exp(self._precision * (np.minimum(demands, 1.0).T[..., None] - self._axis) ** 2)
        return kernels

    def _read(self, kernels: Array) -> Array:
        """Kernel averages (n,) of the competence, one dimension after the other."""
        count, regions = kernels.shape[1:]
        weights = kernels / kernels.sum(axis=-1, keepdims=True)
        average: Array = weights[0] @ self._competence.reshape(regions, -1)
        for axis in weights[1:]:
            average = (axis[:, None] @ average.reshape(count, regions, -1))[:, 0]
        return average[:, 0]

    def _learn(self, readiness: float, kernels: Array) -> None:
        """Teach the regions around a task whose kernel has the factors (d, regions)."""
        kernel = kernels[0]
        for axis in kernels[1:]:
            kernel = np.multiply.outer(kernel, axis)
        self._competence += readiness * self._pace * kernel * (1 - self._competence)


@dataclass(frozen=True)
class SimulatedChallenge:
    """A setting for simulated students that isolates one difficulty for teachers.

    Attributes:
        name: name in files and flags, as the paper's challenges are called in results.
        title: name in tables.
        task_space: tasks that the teacher may choose from.
        aptitudes: aptitudes of the students, one run after the other: seed s trains the (s mod n)-th.
        resets: shares of the episodes after which the student forgets everything.
        cuts: intervals per dimension that change places in the teacher's space, 0 for none.
        easy_task: the easiest task (d,), told at high expert knowledge.
        hard_task: the hardest task (d,) that could be feasible; what demands more is not.
        test_set: name of the tasks the student is tested on, which the world has, shuffled or not.
    """

    name: str
    title: str
    task_space: TaskSpace
    aptitudes: tuple[StudentParameters, ...] = (StudentParameters(),)
    resets: tuple[float, ...] = ()
    cuts: int = 0
    easy_task: tuple[float, ...] = (0, 6)
    hard_task: tuple[float, ...] = (3, 0)
    test_set: str = "stump_tracks"

    def tests(self) -> TestSet:
        """Return the test tasks."""
        return load_test_set(self.test_set)


def _simulated(
    name: str, title: str, aptitudes: tuple[StudentParameters, ...] = (StudentParameters(),)
) -> SimulatedChallenge:
    """Return the challenge of Stump Tracks called `name`, for students of these `aptitudes`."""
    real = find_challenge("stump_tracks", name)
    assert real.easy_task is not None, "Stump Tracks has an easy task"
    shared = {key: getattr(real, key) for key in ("resets", "cuts", "easy_task", "test_set")}
    return SimulatedChallenge(name, title, real.task_space, aptitudes, **shared)


SIMULATED_CHALLENGES: tuple[SimulatedChallenge, ...] = (
    _simulated("original", "Original"),
    _simulated("mostly_unfeasible", "Mostly unfeasible"),
    _simulated("mostly_trivial", "Mostly trivial"),
    _simulated("forgetting_student", "Forgetting student"),
    _simulated("rugged_difficulty", "Rugged difficulty"),
    _simulated(
        "diverse_students",
        "Diverse students",
        tuple(StudentParameters(pace=pace, limit=limit) for limit in (0.5, 0.7) for pace in (0.04, 0.08)),
    ),
)
"""As in the paper's appendix C: almost 80 % of the mostly unfeasible space cannot be learned, half of the
mostly trivial one is flat ground, the forgetting student starts anew at 7 and 14 of 20 million steps. Two
limits (its two bodies) with two paces (its two students) stand for the diverse students."""


def find_simulated_challenge(name: str) -> SimulatedChallenge:
    """Return the simulated challenge called `name`.

    Raises:
        ValueError: there is none; the message holds the nearest match.
    """
    known = {challenge.name: challenge for challenge in SIMULATED_CHALLENGES}
    check_known("simulated challenge", name, known, "known:")
    return known[name]

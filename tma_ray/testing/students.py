"""Simulated students: a few equations for trying out teachers without physics.

A task makes demands q in [0, 1]^d on the student: 0 is the easiest value of each dimension, 1 the hardest.
The space of demands is cut into regions with centres c_i, and the student has a competence k_i in [0, 1] in
each. With the kernel K_i(q) = exp(-|q - c_i|^2 / 2 ell^2) its competence at a task is the kernel average

    k(q) = sum_i K_i(q) k_i / sum_i K_i(q),        0 where the task is unfeasible,

from which its episodic return follows, R = -100 + 400 k(q) + noise. An episode teaches and time erodes:

    k_i <- (1 - phi) (k_i + eta (1 - D_i / L) r(q) K_i(q) (1 - k_i)),        r(q) = k(max(q - zone, 0)),

- r, *readiness*: a task teaches as far as the student masters those that are a little easier in every
  dimension, since learning happens only in the zone of proximal development (Vygotsky 1978); what lies
  within one zone of the easiest task needs no preparation (r = 1). This is a smooth form of the toy
  spaces of Portelas et al. 2019, whose hypercubes are locked until a neighbour has been trained enough;
- K_i: experience carries to similar tasks and no further (gradients of generalisation, Shepard 1987);
- 1 - k_i: learning slows down, and mastered tasks teach nothing (exponential curves, Heathcote et al. 2000);
- 1 - D_i / L: the closer a region's difficulty D_i, the mean of its demands, is to the student's limit L,
  the slower it is learned; beyond L, or where a demand is over 1, tasks are unfeasible;
- phi: what is not practised fades exponentially (after Ebbinghaus 1885), everywhere and in every episode.

Simplifications: returns do not depend on the world drawn for a task, learning has no plateaus, and all
episodes are equally long.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.benchmark import find_challenge, load_test_set
from tma_ray.support.validation import check_fields, check_known
from tma_ray.tasks import Answer, Episode, Outcomes, QueryKind, Task, TaskSpace, TestSet, Trajectory
from tma_ray.teachers import Teacher

DISCOUNT = 0.99  # gamma of simulated students; their rewards are constant within an episode

StateValues = Callable[[NDArray[np.float32]], NDArray[np.float64]]  # from observations (n, o) to values (n,)
Evaluate = Callable[
    [Task, bool], Outcomes
]  # from tasks (n, d) and a flag, True for the deterministic policy, to outcomes


def report_episode(teacher: Teacher, episode: Episode, state_values: StateValues, evaluate: Evaluate) -> None:
    """Report `episode` to `teacher`, and answer the teacher's queries.

    Raises:
        ValueError: if a query for a trajectory or an evaluation was not declared in the teacher's class.
    """
    query = teacher.observe(episode)
    while query is not None:
        answer: Answer
        flag = "wants_trajectory" if query.kind is QueryKind.TRAJECTORY else "wants_evaluations"
        if query.kind is QueryKind.STATE_VALUES:
            assert query.observations is not None, "a query for values holds observations"
            answer = state_values(query.observations)
        elif not getattr(teacher, flag):
            raise ValueError(
                f"{type(teacher).__name__} made a query of the kind {query.kind.value!r}: declare "
                f"{flag} = True in its class"
            )
        elif query.kind is QueryKind.TRAJECTORY:  # observations and rewards are constant
            observations = np.tile(episode.initial_observation, (episode.length + 1, 1))
            rewards = np.full(episode.length, episode.episodic_return / episode.length)
            actions = np.zeros((episode.length, 1), np.float32)
            answer = Trajectory(observations, actions, rewards, terminated=False, gamma=DISCOUNT)
        else:
            assert query.tasks is not None, "a query for an evaluation holds tasks"
            answer = evaluate(query.tasks, query.greedy)
        query = teacher.answer(answer)


Array = NDArray[np.float64]

SIMULATION_VERSION = 1  # version of the equations and their parameters, recorded in every simulated run

WORST_RETURN = -100.0  # expected return without competence: a walker that falls at once
RETURN_RANGE = 400.0  # expected return added by full competence; mastery (230) needs a competence of 0.825

STEADY_SPREAD = 0.02
"""Standard deviation of an episode's competence at hopeless and mastered tasks: 8 units of return, as for
random walkers (docs/fidelity.md)."""

UNSTEADY_SPREAD = 0.4  # factor of k (1 - k) in the standard deviation at half-mastered tasks

EPISODE_STEPS = 2_000
"""Environment steps per episode, the time limit of Stump Tracks: 10,000 episodes are the paper's 20 million
steps, also for teachers that count steps."""

DISCOUNTED_SHARE = (1 - DISCOUNT**EPISODE_STEPS) / (1 - DISCOUNT) / EPISODE_STEPS
"""Discounted return of an episode with return 1: about 1/20."""

MOST_REGIONS = 10_000  # largest number of regions of a student, for speed


@dataclass(frozen=True)
class StudentParameters:
    """Parameters of a simulated student, with the symbols of the module's equations.

    The defaults were chosen with Random alone on the original challenge, before any other teacher was run: it
    masters a middling share of the test tasks in 10,000 episodes, and still learns at their end.

    Attributes:
        pace: eta, share of the missing competence that an easy, perfectly prepared episode teaches.
        pace_spread: standard deviation of the logarithm of each student's random factor on `pace`.
        zone: width of the zone of proximal development, in demands.
        reach: ell, distance over which experience carries, in regions.
        forgetting: phi, share of competence lost per episode.
        limit: L, difficulty over which tasks are unfeasible.
        regions: number of regions per dimension, at most 10,000 in all.
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
    """Student without physics, trained one task at a time.

    Args:
        easy: easiest task (d,); easier tasks count as equal to it.
        hard: hardest task (d,) that may be feasible, different from `easy` in every dimension.
        rng: generator for the student's pace, and then for the noise of returns.
        aptitude: parameters of the student.

    Raises:
        ValueError: if shapes do not match, a dimension has no width, or there are too many regions.
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
        """Forget everything learned."""
        self._competence = np.zeros_like(self._pace)

    def play(self, task: ArrayLike, trains: bool = True) -> float:
        """Play one episode of `task` (d,), learn from it if `trains`, and return the episodic return."""
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
        """Return the demands of `tasks` (..., d), which are their initial observations (..., d)."""
        demands = (np.asarray(tasks, dtype=np.float64) - self._easy) / (self._hard - self._easy)
        return np.maximum(demands, 0.0).astype(np.float32)

    def expected_returns(self, tasks: ArrayLike) -> Array:
        """Return the expected episodic returns (n,) of `tasks` (n, d)."""
        return self._expected(self.initial_observations(tasks))

    def state_values(self, observations: NDArray[np.float32]) -> Array:
        """Return the expected discounted returns (n,) for observations (n, d)."""
        if (observations == observations[0]).all():  # as in a trajectory
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
        """Return the factors (d, n, regions) whose product over dimensions is the kernel."""
        kernels: Array = np.exp(self._precision * (np.minimum(demands, 1.0).T[..., None] - self._axis) ** 2)
        return kernels

    def _read(self, kernels: Array) -> Array:
        """Return the kernel averages (n,) of the competence, computed dimension by dimension."""
        count, regions = kernels.shape[1:]
        weights = kernels / kernels.sum(axis=-1, keepdims=True)
        average: Array = weights[0] @ self._competence.reshape(regions, -1)
        for axis in weights[1:]:
            average = (axis[:, None] @ average.reshape(count, regions, -1))[:, 0]
        return average[:, 0]

    def _learn(self, readiness: float, kernels: Array) -> None:
        """Update the competence around a task, given the factors (d, regions) of its kernel."""
        kernel = kernels[0]
        for axis in kernels[1:]:
            kernel = np.multiply.outer(kernel, axis)
        self._competence += readiness * self._pace * kernel * (1 - self._competence)


@dataclass(frozen=True)
class SimulatedChallenge:
    """Challenge for simulated students.

    Attributes:
        name: name in results and flags.
        aptitudes: parameters of the students; seed s trains the (s mod n)-th.
        resets: shares of the episodes after which the student is reset.
        cuts: shuffled intervals per dimension of the task space, 0 for none.
        easy_task: easiest task (d,), part of high expert knowledge.
        hard_task: hardest task (d,) that may be feasible.
        test_set: name of the test set, in coordinates of the world.
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
    """Return the simulated version of a challenge of Stump Tracks."""
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
"""The challenges of the paper's appendix C: almost 80 % of the mostly unfeasible space cannot be learned,
half of the mostly trivial one is flat ground, the forgetting student is reset after 7 and 14 of 20 million
steps. Diverse students combine two limits (for two bodies) with two paces (for two students)."""


def find_simulated_challenge(name: str) -> SimulatedChallenge:
    """Return the simulated challenge called `name`, or raise a ValueError with the nearest match."""
    challenges = {challenge.name: challenge for challenge in SIMULATED_CHALLENGES}
    check_known("simulated challenge", name, challenges, "known:")
    return challenges[name]

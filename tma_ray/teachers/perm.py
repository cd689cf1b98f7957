"""PERM, a parameterised environment response model (Tio and Varakantham 2023)."""

from collections import deque
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.support.validation import check_at_least, check_positive, check_shares
from tma_ray.tasks import Episode, ExpertKnowledge, Task, TaskSpace, TeacherUpdate
from tma_ray.teachers.base import PAPER_BUDGET, Teacher, for_budget
from tma_ray.teachers.numerics import (
    HIGHEST_RETURN,
    LOWEST_RETURN,
    Array,
    UnitBox,
    cloud_gaussian,
    one_thread,
    scaled_returns,
)

MOST_STEPS, SMALLEST_STEP = 50, 1e-8  # stopping criteria of Newton's method


class ResponseModel(NamedTuple):
    """Item-response model of the student's ability and the tasks' difficulty.

    A response y in [0, 1] has the log-likelihood y log p + (1 - y) log (1 - p), with p = sigmoid(a - d), an
    ability a per window of episodes, and the difficulty d = features @ weights.
    """

    ability_std: float = 3.0  # prior standard deviation of the ability in the first window
    drift_std: float = 0.5  # prior standard deviation of changes in ability between windows
    weight_std: float = 3.0  # prior standard deviation of each weight

    def fit(self, features: Array, windows: NDArray[np.int64], responses: Array) -> tuple[Array, Array]:
        """Return the maximum a posteriori abilities (k,) and weights (m,).

        Args:
            features: features of the tasks (n, m).
            windows: index of each response's window (n,), from 0 to k - 1.
            responses: responses y (n,).
        """
        count = int(windows.max()) + 1
        design = np.hstack([np.eye(count)[windows], -features])
        precision = np.diag(np.append(np.zeros(count), np.full(features.shape[1], self.weight_std**-2.0)))
        changes = np.diff(np.eye(count), axis=0)
        precision[:count, :count] = changes.T @ changes / self.drift_std**2
        precision[0, 0] += self.ability_std**-2.0
        with one_thread():
            parameters = _most_probable(design, responses, precision)
        return parameters[:count], parameters[count:]


def _most_probable(design: Array, responses: Array, precision: Array) -> Array:
    """Return the maximum a posteriori parameters (p,) of logistic regression with a Gaussian prior."""

    def loss(parameters: Array) -> float:
        logits = design @ parameters
        misfit = np.logaddexp(0, logits) - responses * logits
        return float(misfit.sum() + parameters @ precision @ parameters / 2)

    parameters = np.zeros(design.shape[1])
    for _ in range(MOST_STEPS):
        chances = 1 / (1 + np.exp(-design @ parameters))
        gradient = design.T @ (chances - responses) + precision @ parameters
        curvature = (design.T * (chances * (1 - chances))) @ design + precision
        step = np.linalg.solve(curvature, gradient)
        while loss(parameters - step) > loss(parameters) and np.abs(step).max() > SMALLEST_STEP:
            step /= 2
        parameters -= step
        if np.abs(step).max() < SMALLEST_STEP:
            break
    return parameters


@dataclass
class PERM(Teacher):
    """Teacher that samples tasks whose difficulty matches the student's ability.

    An item-response model estimates both; it explains returns, scaled to [0, 1], by the student's ability
    minus the difficulty of the task. It is fitted to the latest windows of episodes, each with its own
    ability. Difficulty is a weighted sum of Gaussian bumps in the task space, each with mean 0. A task is the
    uniform candidate whose difficulty is nearest to the latest ability. Before the first fit tasks are
    uniform.

    Sources: Tio and Varakantham 2023 (arXiv:2306.13028) for the idea of latent ability and difficulty,
    inferred from returns and parameters, and difficulty matched to ability. Its equations could not be read,
    and its model is trained offline. This online model and its hyper-parameters are our choice.

    Attributes:
        window_episodes: episodes of a window, after which the model is fitted.
        windows: latest windows in a fit.
        bumps: number of Gaussian bumps (radial basis functions) in the difficulty.
        bump_width: standard deviation of a bump, as a share of the unit box's diagonal.
        candidates: number of uniform candidates.
        explore: share of uniform tasks after the first fit, in [0, 1].
        lowest_return: return that is scaled to 0.
        highest_return: return that is scaled to 1.
        budget: environment steps of the run, to which `for_budget` fits window_episodes.
    """

    overlapping: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1
    single_task: ClassVar[bool] = False

    window_episodes: int = 150
    windows: int = 10
    bumps: int = 50
    bump_width: float = 0.15
    candidates: int = 100
    explore: float = 0.1
    lowest_return: float = LOWEST_RETURN
    highest_return: float = HIGHEST_RETURN
    budget: int = PAPER_BUDGET

    def __post_init__(self) -> None:
        check_at_least(self, 1, "window_episodes", "windows", "bumps", "candidates")
        check_positive(self, "bump_width")
        check_shares(self, "explore")
        scaled_returns(np.empty(0), self.lowest_return, self.highest_return)
        for_budget(self.window_episodes, self.budget)

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Draw the centres of the bumps, and start with uniform tasks."""
        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        self._window = for_budget(self.window_episodes, self.budget)
        self.centres_ = rng.random((self.bumps, self._box.size))
        self.history_: deque[tuple[Task, float]] = deque(maxlen=self._window * self.windows)
        self.episodes_ = 0
        self.weights_: Array | None = None
        self.ability_ = 0.0

    def sample(self) -> Task:
        """Return a task (d,) of suitable difficulty or, with probability `explore`, a uniform one."""
        if self.rng.random() < self.explore:
            return self.space.sample(self.rng)
        return self._suitable(self.rng)

    def observe(self, episode: Episode) -> None:
        """Store the episode, and fit the model at the end of a window."""
        self.history_.append((episode.task, episode.episodic_return))
        self.episodes_ += 1
        if self.episodes_ % self._window == 0:
            self._fit()

    def probe(self, count: int) -> Task:
        """Return `count` tasks (count, d) of suitable difficulty."""
        rng = self.probe_rng()
        return np.stack([self._suitable(rng) for _ in range(count)])

    def features(self, points: Array) -> Array:
        """Return the values (n, m) of all bumps, shifted to mean 0, at `points` (n, f) in the unit box."""
        from scipy.spatial.distance import cdist  # deferred, so that listing teachers does not import scipy
        from scipy.special import ndtr

        width = self.bump_width * np.sqrt(self._box.size)
        heights = np.exp(-cdist(points, self.centres_, "sqeuclidean") / (2 * width**2))
        inside = ndtr((1 - self.centres_) / width) - ndtr(-self.centres_ / width)
        means = (width * np.sqrt(2 * np.pi) * inside).prod(axis=1)
        return np.asarray(heights - means, dtype=np.float64)

    def difficulty(self, tasks: Task) -> Array:
        """Return the difficulties (n,) of `tasks` (n, d), 0 before the first fit."""
        if self.weights_ is None:
            return np.zeros(len(tasks))
        return np.asarray(self.features(self._box.normalise(tasks)) @ self.weights_, dtype=np.float64)

    def _suitable(self, rng: np.random.Generator) -> Task:
        if self.weights_ is None:
            return self.space.sample(rng)
        tasks = self.space.sample(rng, self.candidates)
        task: Task = tasks[np.abs(self.difficulty(tasks) - self.ability_).argmin()]
        return task

    def _fit(self) -> None:
        tasks = np.stack([task for task, _ in self.history_])
        returns = np.array([episodic_return for _, episodic_return in self.history_])
        responses = scaled_returns(returns, self.lowest_return, self.highest_return)
        windows = np.arange(len(responses)) // self._window
        abilities, self.weights_ = ResponseModel().fit(
            self.features(self._box.normalise(tasks)), windows, responses
        )
        self.ability_ = float(abilities[-1])
        latest = tasks[-self._window :]
        scalars = {
            "ability": self.ability_,
            "mean_difficulty": float(self.difficulty(latest).mean()),
            "mean_response": float(responses[-self._window :].mean()),
        }
        self.log(TeacherUpdate(gaussians=(cloud_gaussian(self.space, latest),), scalars=scalars))

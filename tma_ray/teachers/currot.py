"""CURROT, a curriculum by constrained optimal transport (Klink et al. 2022)."""

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.support.validation import check_at_least, check_positive
from tma_ray.tasks import Episode, ExpertKnowledge, KnowledgeLevel, Task, TaskSpace, TeacherUpdate
from tma_ray.teachers.base import DistributionTeacher
from tma_ray.teachers.numerics import Array, UnitBox, cloud_gaussian

ROWS_AT_ONCE = 2_000  # largest number of rows predicted at once, to bound memory


def assigned(sources: Array, targets: Array) -> NDArray[np.int64]:
    """Return the indices (n,) of the targets optimally assigned to `sources` (n, f).

    The assignment minimises the sum of squared distances. There are at least as many `targets` (m, f).
    """
    from scipy.optimize import linear_sum_assignment  # deferred: listing teachers must not import scipy
    from scipy.spatial.distance import cdist

    rows, columns = linear_sum_assignment(cdist(sources, targets, "sqeuclidean"))
    assert len(rows) == len(sources), "there are as many targets as sources"
    indices: NDArray[np.int64] = columns
    return indices


class Performance(NamedTuple):
    """Nadaraya-Watson regression of returns (n,) on points (n, f), with a Gaussian kernel."""

    points: Array
    returns: Array
    width: float

    def __call__(self, points: Array) -> Array:
        """Return the expected returns (k,) at `points` (k, f)."""
        from scipy.spatial.distance import cdist

        results = []
        for first in range(0, len(points), ROWS_AT_ONCE):
            squares = cdist(points[first : first + ROWS_AT_ONCE], self.points, "sqeuclidean")
            exponents = (squares.min(axis=1, keepdims=True) - squares) / (2 * self.width**2)
            weights = np.exp(exponents.astype(np.float32))
            results.append((weights @ self.returns.astype(np.float32)) / weights.sum(axis=1))
        return np.concatenate(results).astype(np.float64)


CANDIDATES, LINE_CANDIDATES = 20, 10  # per particle, in a ball around it and on the line to its target


def moved(
    particles: Array,
    targets: Array,
    performance: Performance,
    least: float,
    radius: float,
    rng: np.random.Generator,
) -> Array:
    """Return `particles` (n, f), moved towards `targets` (n, f) as far as expected returns allow.

    Both are in the unit box. Candidates are points in a ball of `radius` around the particle, in the half
    towards its target if the particle's expected return is at least `least`. The nearest candidate to the
    target with such a return is chosen, or the one of highest expected return if there is none.
    """
    count, size = particles.shape
    ways = targets - particles
    lengths = np.linalg.norm(ways, axis=1)
    reach = np.minimum(radius, lengths)[:, None, None]
    directions = (ways / np.maximum(lengths, 1e-12)[:, None])[:, None]
    ready = (performance(particles) >= least)[:, None, None]
    noise = rng.standard_normal((count, CANDIDATES, size))
    noise /= np.linalg.norm(noise, axis=-1, keepdims=True)
    noise *= rng.random((count, CANDIDATES, 1)) ** (1 / size)
    backwards = np.minimum((noise * directions).sum(axis=-1, keepdims=True), 0.0)
    noise -= np.where(ready, 2 * backwards, 0.0) * directions
    shares = np.linspace(0, 1, LINE_CANDIDATES + 1)[None, :, None]  # 0 is the particle itself
    offsets = np.concatenate([reach * shares * directions, reach * noise], axis=1)
    candidates = np.clip(particles[:, None] + offsets, 0.0, 1.0)
    expected = performance(candidates.reshape(-1, size)).reshape(count, -1)
    distances = np.linalg.norm(candidates - targets[:, None], axis=-1)
    feasible = expected >= least
    distances[~feasible] = np.inf
    chosen = np.where(feasible.any(axis=1), distances.argmin(axis=1), expected.argmax(axis=1))
    positions: Array = candidates[np.arange(count), chosen]
    return positions


WIDEST_NOISE = 0.25  # standard deviation of the extra noise around the worst task, as a share of each range


@dataclass
class SuccessBuffer:
    """Buffer of the tasks with the highest returns (authors' code).

    Until their median reaches `least`, tasks of at least the median return replace the worst half. Afterwards
    successes replace failures, and a full buffer of successes keeps those in the optimal assignment to the
    target distribution.
    """

    size: int  # number f of coordinates
    capacity: int  # largest number of tasks
    least: float  # smallest return that counts as a success
    points: Array = field(init=False)  # coordinates of the tasks in [0, 1] (n, f)
    returns: Array = field(init=False)  # return of one episode per task (n,)
    reached: bool = field(init=False, default=False)  # True if the median has reached `least`
    worst: float = field(init=False, default=np.inf)  # lowest return of the first tasks added

    def __post_init__(self) -> None:
        self.points, self.returns = np.empty((0, self.size)), np.empty(0)

    def add(self, points: Array, returns: Array, targets: Array) -> NDArray[np.bool_]:
        """Add tasks with high returns, and return a mask (k,) of the tasks not added.

        Args:
            points: tasks (k, f).
            returns: returns (k,).
            targets: draws of the target distribution (`capacity`, f).
        """
        if not len(self.returns):
            self.worst = float(returns.min())
        good = returns >= (self.least if self.reached else self._median)
        may_go = int((self.returns < self.least).sum()) if self.reached else len(self.returns) // 2 + 1
        order = np.argsort(self.returns, kind="stable")
        kept = np.sort(order[min(int(good.sum()), may_go) :])
        everything = np.concatenate([points[good], self.points[kept]])
        all_returns = np.concatenate([returns[good], self.returns[kept]])
        if len(all_returns) <= self.capacity:
            chosen = np.arange(len(all_returns))
        elif self.reached and all_returns.min() >= self.least:
            chosen = np.sort(assigned(targets[: self.capacity], everything))
        else:
            chosen = np.sort(np.argsort(-all_returns, kind="stable")[: self.capacity])
        self.points, self.returns = everything[chosen], all_returns[chosen]
        left_out = ~good
        left_out[good] = ~np.isin(np.arange(good.sum()), chosen)
        self.reached = self.reached or self._median >= self.least
        return left_out

    def draw(self, rng: np.random.Generator, count: int, narrowest: float) -> Array:
        """Draw `count` points (count, f) around the stored tasks, with more noise around those of low return.

        Noise around successes has the standard deviation `narrowest`, as a share of each range.
        """
        below = np.maximum(self.least - self.returns, 0.0) / max(self.least - self.worst, 1e-9)
        deviations = narrowest + WIDEST_NOISE * np.minimum(below, 1.0)
        if self.reached:
            indices = np.arange(count) % len(self.returns)
        else:
            merits = np.maximum(self.returns - self._median, 0.0)
            merits = merits if merits.sum() > 0 else np.ones(len(self.returns))
            indices = rng.choice(len(self.returns), count, p=merits / merits.sum())
        noise = deviations[indices, None] * rng.standard_normal((count, self.size))
        return np.clip(self.points[indices] + noise, 0.0, 1.0)

    @property
    def _median(self) -> float:
        return float(np.median(self.returns)) if len(self.returns) else -np.inf


NARROWEST = 0.005  # standard deviation of noise around successes, as a share of the radius (authors' code)
JITTER = 1e-3  # half width of a task's uniform noise, as a share of each range (authors' code)


@dataclass
class CURROT(DistributionTeacher):
    """Teacher that samples from particles, which move towards a target distribution as returns allow.

    A task is a random particle. Every `update_every` episodes an optimal assignment gives each particle a
    uniform random target; it moves to the nearest point in a ball around it with an expected return of at
    least `least_return`. Particles of lower return are first put near successes. Expected returns are kernel
    averages over the latest failures and a buffer of successes.

    Sources: Klink et al. 2022, algorithm 1 and section 4; the authors' code, with their hyper-parameters for
    Stump Tracks.

    Attributes:
        least_return: smallest expected return of a particle (paper: delta).
        particles: number of particles, and largest number of successes and of failures.
        update_every: episodes between two updates.
        radius: largest move, as a share of the diagonal of the space (paper: epsilon).
        kernel_width: standard deviation of the kernel of expected returns, as a share of the radius.
    """

    overlapping: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1
    single_task: ClassVar[bool] = False
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.LOW, KnowledgeLevel.HIGH)

    least_return: float = 180.0
    particles: int = 250
    update_every: int = 50
    radius: float = 0.05
    kernel_width: float = 1.0

    def __post_init__(self) -> None:
        check_at_least(self, 1, "particles", "update_every")
        check_positive(self, "radius", "kernel_width")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Draw the particles, from the initial Gaussian at high knowledge, otherwise uniformly."""
        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        self._radius = self.radius * np.sqrt(self._box.size)
        if knowledge.level is KnowledgeLevel.HIGH:
            tasks = knowledge.initial.sample(space, rng, self.particles)
        else:
            tasks = space.sample(rng, self.particles)
        self.particles_ = self._box.normalise(tasks)
        self.successes_ = SuccessBuffer(self._box.size, self.particles, self.least_return)
        self.failures_ = np.empty((0, self._box.size + 1))
        self.latest_ = np.empty((0, self._box.size + 1))

    def draw(self, rng: np.random.Generator, count: int) -> Task:
        """Return `count` tasks (count, d), each a random particle with a little noise."""
        points = self.particles_[rng.integers(len(self.particles_), size=count)]
        return self._box.denormalise(points + JITTER * rng.uniform(-1, 1, points.shape))

    def observe(self, episode: Episode) -> None:
        """Store the episode, and update the particles when an update is due."""
        row = np.append(self._box.normalise(episode.task), episode.episodic_return)
        self.latest_ = np.vstack([self.latest_, row])
        if len(self.latest_) == self.update_every:
            self._update()

    def _update(self) -> None:
        count, size = self.particles_.shape
        targets = self.rng.random((count, size))
        points, returns = self.latest_[:, :-1], self.latest_[:, -1]
        left_out = self.successes_.add(points, returns, targets)
        self.failures_ = np.vstack([self.failures_, self.latest_[left_out]])[-count:]
        self.latest_ = self.latest_[:0]
        played = np.vstack([self.failures_[:, :-1], self.successes_.points])
        played_returns = np.append(self.failures_[:, -1], self.successes_.returns)
        performance = Performance(played, played_returns, self.kernel_width * self._radius)
        # particles with low expected returns first move near successes
        particles, low = self.particles_, performance(self.particles_) < self.least_return
        if low.any():
            successes = self.successes_.draw(self.rng, count, NARROWEST * self._radius)
            particles = np.where(low[:, None], successes[assigned(particles, successes)], particles)
        order = assigned(particles, targets)
        self.particles_ = moved(
            particles, targets[order], performance, self.least_return, self._radius, self.rng
        )
        distance = float(np.sqrt(((self.particles_ - targets[order]) ** 2).sum(axis=1).mean()))
        scalars = {
            "target_distance": distance,
            "mean_return": float(returns.mean()),
            "successes": float((self.successes_.returns >= self.least_return).sum()),
        }
        gaussian = cloud_gaussian(self.space, self._box.denormalise(self.particles_))
        self.log(TeacherUpdate(gaussians=(gaussian,), scalars=scalars))

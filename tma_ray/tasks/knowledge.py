"""Expert knowledge about a task space, and test sets for evaluations."""

import csv
import hashlib
import io
import itertools
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.support.decoding import MOST_TEXT_BYTES, read_file
from tma_ray.support.validation import check_finite, check_type, check_whole
from tma_ray.tasks.spaces import ShuffledSpace, Task, TaskSpace


@dataclass(frozen=True, eq=False)
class TestSet:
    """Tasks of an evaluation, in order.

    Attributes:
        name: name in tables; part of the seed of every evaluation world.
        dimensions: names of the tasks' dimensions (d).
        tasks: tasks, float32 (n, d).
    """

    __test__ = False  # keeps pytest from collecting it as a test class

    name: str
    dimensions: tuple[str, ...]
    tasks: Task

    def __post_init__(self) -> None:
        check_type("tasks", self.tasks, np.ndarray, "an array (n, d)")
        if not self.name or not np.isfinite(self.tasks).all():
            raise ValueError(f"test set {self.name!r}: expected a name, and tasks of finite numbers")
        if self.tasks.ndim != 2 or self.tasks.shape[1] != len(self.dimensions) or not len(self.tasks):
            raise ValueError(
                f"test set {self.name!r}: tasks of shape {self.tasks.shape} do not fit the dimensions "
                f"{', '.join(self.dimensions)}; expected (n, {len(self.dimensions)}) with n > 0"
            )

    def __len__(self) -> int:
        return len(self.tasks)

    def __repr__(self) -> str:
        """Return a short description without the tasks, for use in messages."""
        return f"TestSet({self.name!r}, {', '.join(self.dimensions)}: {len(self)} tasks, {self.digest})"

    @property
    def digest(self) -> str:
        """Hash of dimensions and tasks that distinguishes sets of the same name."""
        content = ",".join(self.dimensions).encode() + np.ascontiguousarray(self.tasks).tobytes()
        return hashlib.sha256(content).hexdigest()[:16]

    @classmethod
    def grid(cls, name: str, space: TaskSpace, points: int) -> "TestSet":
        """Return a grid with `points` values per dimension, bounds included, in row-major order."""
        check_whole("points", points, 1)
        axes = [np.linspace(d.low, d.high, points) for d in space.dimensions]
        return cls(name, space.names, np.array(list(itertools.product(*axes)), dtype=np.float32))

    @classmethod
    def from_csv(cls, path: str | Path, name: str | None = None) -> "TestSet":
        """Read a test set from a CSV file with a header of dimension names and one task per line.

        A byte order mark, as written by Excel, and blanks around names and numbers are ignored.

        Raises:
            ValueError: if a line is not a task, or the file is not a text.
        """
        path = Path(path)
        text = read_file(path, MOST_TEXT_BYTES).decode("utf-8-sig")
        table = csv.reader(io.StringIO(text, newline=""))
        rows = [row for row in ([cell.strip() for cell in row] for row in table) if any(row)]
        if len(rows) < 2:
            raise ValueError(f"{path}: a test set has a header of dimension names and at least one task")
        tasks, size = [], len(rows[0])
        for line, row in enumerate(rows[1:], start=2):
            try:
                tasks.append([float(value) for value in row])
            except ValueError as error:
                raise ValueError(f"{path}, line {line}: {row} is not a list of numbers") from error
            if len(row) != size or not np.all(np.isfinite(tasks[-1])):
                raise ValueError(f"{path}, line {line}: expected {size} finite numbers, got {row}")
        return cls(name or path.stem, tuple(rows[0]), np.array(tasks, dtype=np.float32))

    def to_csv(self) -> str:
        """Return the test set as CSV, from which `from_csv` reads exactly the same tasks."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.dimensions)
        writer.writerows([[str(value) for value in task] for task in self.tasks])
        return text.getvalue()

    def check(self, domain: TaskSpace) -> None:
        """Check that all tasks are in `domain`, the valid domain of an environment.

        Raises:
            ValueError: if dimensions differ, or a task is outside.
        """
        if self.dimensions != domain.names:
            raise ValueError(
                f"test set {self.name!r} has dimensions {', '.join(self.dimensions)}; "
                f"the environment's are {', '.join(domain.names)}"
            )
        for index, task in enumerate(self.tasks):
            if not domain.contains(task):
                raise ValueError(
                    f"test set {self.name!r}: task {index} {task.tolist()} is outside the valid domain"
                )


MASTERY_RETURN = 230.0
"""Episodic return over which a task is mastered (paper, section 4 and appendix C)."""

# standard deviations of both Gaussians, as shares of a dimension's range (paper, appendix C)
INITIAL_STD_SHARE, TARGET_STD_SHARE = 0.1, 0.25
CONSTANT_DIMENSION_VARIANCE = 1e-6  # for constant dimensions, whose range is 0


class KnowledgeLevel(StrEnum):
    """Amounts of expert knowledge, in increasing order (paper)."""

    NONE = "none"
    LOW = "low"
    HIGH = "high"

    @classmethod
    def _missing_(cls, value: object) -> "KnowledgeLevel":
        raise ValueError(f"expert knowledge {value!r}: expected {', '.join(cls)}")

    @property
    def rank(self) -> int:
        """Rank of the level: 0 for none, 1 for low, 2 for high."""
        return list(KnowledgeLevel).index(self)


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Axis-aligned Gaussian over tasks, with mean (d,) and variance (d,) in task units."""

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]

    def sample(self, space: TaskSpace, rng: np.random.Generator, count: int | None = None) -> Task:
        """Return one task (d,), or `count` of them (count, d), clipped to `space`."""
        size = None if count is None else (count, self.mean.size)
        return space.clip(rng.normal(self.mean, np.sqrt(self.variance), size=size))


@dataclass(frozen=True, eq=False)
class ExpertKnowledge:
    """Expert knowledge given to a teacher (paper, appendix C, expert knowledge setups).

    Attributes:
        level: amount of knowledge.
        mastery_threshold: episodic return over which a task is mastered; None at level none.
        initial: initial task distribution, informative at level high, else with a random mean.
        target: target task distribution, always wide, since a specific target is unknown.
    """

    level: KnowledgeLevel
    mastery_threshold: float | None
    initial: Gaussian
    target: Gaussian


def expert_knowledge(
    level: KnowledgeLevel,
    space: TaskSpace,
    placement: np.random.Generator,
    easy_task: ArrayLike | None = None,
    mastery_threshold: float = MASTERY_RETURN,
    landscape: ShuffledSpace | None = None,
) -> ExpertKnowledge:
    """Return the expert knowledge of `level` about a task space.

    Args:
        level: amount of knowledge.
        space: task space of the teacher.
        placement: generator of the initial mean below level high. It is drawn at every level, so that later
            draws do not depend on the level.
        easy_task: an easy task (d,) of the world, the initial mean at level high.
        mastery_threshold: episodic return of mastery, known from level low on.
        landscape: map from the teacher's tasks to the world's if the space is shuffled. The easy task is
            mapped back; variances are not.

    Raises:
        ValueError: if level high has no easy task, or one outside the space.
    """
    level = KnowledgeLevel(level)
    check_type("placement", placement, np.random.Generator, "a Generator of numpy's")
    check_finite("mastery_threshold", mastery_threshold)
    mean = space.low + placement.random(space.size) * space.width
    if level is KnowledgeLevel.HIGH:
        if easy_task is None:
            raise ValueError(
                "expert knowledge 'high' needs an easy task, and this space declares none; use 'low'"
            )
        if not space.contains(easy_task):
            raise ValueError(f"the easy task {np.asarray(easy_task).tolist()} lies outside the task space")
        initial = easy_task if landscape is None else landscape.from_world(easy_task)
        mean = np.asarray(initial, dtype=np.float64)
    return ExpertKnowledge(
        level=level,
        mastery_threshold=None if level is KnowledgeLevel.NONE else mastery_threshold,
        initial=Gaussian(mean, _variance(space, INITIAL_STD_SHARE)),
        target=Gaussian(space.centre, _variance(space, TARGET_STD_SHARE)),
    )


def _variance(space: TaskSpace, std_share: float) -> NDArray[np.float64]:
    return np.where(space.width > 0, (std_share * space.width) ** 2, CONSTANT_DIMENSION_VARIANCE)

"""Task spaces of teachers, with or without shuffled regions."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.support.validation import check_finite, check_pair, check_sequence, check_type, check_whole

Task: TypeAlias = NDArray[np.float32]
"""Task (d,) or tasks (n, d) of an environment."""


@dataclass(frozen=True)
class Dimension:
    """Dimension of a task space, a parameter of the world's procedural generation.

    Attributes:
        name: name in test sets and tables.
        low: smallest value.
        high: largest value, equal to `low` for a constant dimension.
        unit: unit of the values ("m", "terrain steps"), empty for a pure number.
    """

    name: str
    low: float
    high: float
    unit: str = ""

    def __post_init__(self) -> None:
        check_type("name of a dimension", self.name, str, "a text")
        check_type("unit", self.unit, str, "a text")
        if not self.name:
            raise ValueError("a dimension needs a name, as it is called in test sets and tables")
        check_finite(f"dimension {self.name!r}: low", self.low)
        check_finite(f"dimension {self.name!r}: high", self.high)
        if self.low > self.high:
            raise ValueError(f"dimension {self.name!r}: low {self.low} is over high {self.high}; swap them")


@dataclass(frozen=True)
class TaskSpace:
    """Box of tasks with named, bounded dimensions, some of which may be constant.

    Examples:
        >>> space = TaskSpace((Dimension("height", 0, 3), Dimension("spacing", 0, 6, "m")))
        >>> space.contains([1.5, 7.0])
        False
        >>> space.clip([1.5, 7.0]).tolist()
        [1.5, 6.0]
        >>> space.normalise([1.5, 3.0]).tolist()
        [0.5, 0.5]
    """

    dimensions: tuple[Dimension, ...]

    def __post_init__(self) -> None:
        check_sequence("dimensions", self.dimensions)
        for dimension in self.dimensions:
            check_type("dimension", dimension, Dimension, "a Dimension(name, low, high)")
        if not self.dimensions:
            raise ValueError("a task space needs at least one dimension")
        if len(set(self.names)) != len(self.names):
            raise ValueError(f"dimension names must differ, got {list(self.names)}")

    @classmethod
    def from_bounds(
        cls, bounds: dict[str, tuple[float, float]], units: dict[str, str] | None = None
    ) -> "TaskSpace":
        """Return the space with `bounds` (low and high by name) and optional `units` by name."""
        units = units or {}
        for name, pair in bounds.items():
            check_pair(f"bounds of {name!r}", pair, "low and high")
        return cls(tuple(Dimension(n, low, high, units.get(n, "")) for n, (low, high) in bounds.items()))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the dimensions, in the order of a task's values."""
        return tuple(dimension.name for dimension in self.dimensions)

    @property
    def size(self) -> int:
        """Number d of dimensions, constant ones included."""
        return len(self.dimensions)

    @cached_property
    def low(self) -> Task:
        """Lower bounds (d,)."""
        return np.array([dimension.low for dimension in self.dimensions], dtype=np.float32)

    @cached_property
    def high(self) -> Task:
        """Upper bounds (d,)."""
        return np.array([dimension.high for dimension in self.dimensions], dtype=np.float32)

    @cached_property
    def width(self) -> NDArray[np.float64]:
        """Widths of the dimensions (d,), 0 for constant ones."""
        return self.high.astype(np.float64) - self.low.astype(np.float64)

    @property
    def centre(self) -> NDArray[np.float64]:
        """Centre of the box (d,)."""
        return self.low + self.width / 2

    def sample(self, rng: np.random.Generator, count: int | None = None) -> Task:
        """Return one uniform task (d,), or `count` of them (count, d)."""
        check_type("rng", rng, np.random.Generator, "a Generator of numpy's, as np.random.default_rng(0)")
        check_whole("count", 0 if count is None else count, 0)
        shape = self.size if count is None else (count, self.size)
        return self.clip(self.low + rng.random(shape) * self.width)

    def clip(self, tasks: ArrayLike) -> Task:
        """Clip `tasks` (..., d) to the box, as float32."""
        return np.clip(self._checked(tasks).astype(np.float32), self.low, self.high)

    def contains(self, tasks: ArrayLike) -> bool:
        """Return True if all `tasks` (..., d) are in the closed box and not NaN."""
        values = self._checked(tasks).astype(np.float32)
        return bool(np.all((values >= self.low) & (values <= self.high)))

    def normalise(self, tasks: ArrayLike) -> NDArray[np.float64]:
        """Map `tasks` (..., d) to the unit box; constant dimensions map to 0.5."""
        offset = self._checked(tasks) - self.low.astype(np.float64)
        free = self.width > 0
        return np.where(free, offset / np.where(free, self.width, 1.0), 0.5)

    def denormalise(self, points: ArrayLike) -> Task:
        """Map `points` (..., d) in the unit box to tasks, clipped to this box."""
        return self.clip(self.low + self._checked(points) * self.width)

    def with_bounds(self, name: str, low: float, high: float) -> "TaskSpace":
        """Return a copy of the space with new bounds for the dimension `name`."""
        if name not in self.names:
            raise ValueError(f"no dimension {name!r}; the space has {', '.join(self.names)}")
        return TaskSpace(
            tuple(Dimension(d.name, low, high, d.unit) if d.name == name else d for d in self.dimensions)
        )

    def _checked(self, tasks: ArrayLike) -> NDArray[np.float64]:
        values = np.asarray(tasks, dtype=np.float64)
        if values.ndim == 0 or values.shape[-1] != self.size:
            raise ValueError(
                f"tasks of shape {values.shape} do not fit a space of {self.size} dimensions "
                f"({', '.join(self.names)}); expected (..., {self.size})"
            )
        return values


def task_values(tasks: ArrayLike | Mapping[str, ArrayLike], space: TaskSpace) -> NDArray[np.generic]:
    """Convert tasks to an array (..., d).

    Args:
        tasks: an array, or the values of every dimension by name, with shapes that broadcast to (...,).
        space: task space with these names.

    Raises:
        ValueError: if a name is missing or unknown.
    """
    if not isinstance(tasks, Mapping):
        return np.asarray(tasks)
    if tasks.keys() != set(space.names):
        raise ValueError(f"task has the names {list(tasks)}: expected exactly {', '.join(space.names)}")
    return np.stack(np.broadcast_arrays(*(tasks[name] for name in space.names)), axis=-1)


def check_task(task: ArrayLike | Mapping[str, float], domain: TaskSpace) -> Task:
    """Check a task, given as values or as a dict by name, and return a float32 copy (d,).

    Raises:
        ValueError: if shape or names differ, or a value is not finite or outside `domain`.
    """
    values = np.array(task_values(task, domain), dtype=np.float32)
    if values.shape != (domain.size,):
        raise ValueError(f"a task has shape ({domain.size},) ({', '.join(domain.names)}), got {values.shape}")
    for value, dimension in zip(values, domain.dimensions, strict=True):
        if not np.float32(dimension.low) <= value <= np.float32(dimension.high):
            raise ValueError(
                f"task {[round(float(number), 4) for number in values]}: {dimension.name} = {value:g} is "
                f"outside its valid domain [{dimension.low:g}, {dimension.high:g}]"
            )
    return values


CUTS = 4  # number of intervals per dimension (paper, appendix C, rugged difficulty landscape)


@dataclass(frozen=True, eq=False)
class ShuffledSpace:
    """Task space with shuffled regions, which maps the teacher's tasks to different tasks of the world.

    Every dimension is cut into equal intervals, which are permuted independently of other dimensions. The
    box remains the same; a smooth path through it jumps at the ends of intervals. A boundary between two
    intervals belongs to the lower one. Both maps are linear within an interval, and inverses up to float32
    rounding, which never leaves the interval. Constant dimensions are unchanged.

    Source: paper, appendix C, algorithms for cutting and shuffling and for interpolation.

    Attributes:
        space: task space of the teacher, and of the world.
        order: index of the world's interval for each of the teacher's intervals (d, cuts).

    Examples:
        >>> line = TaskSpace.from_bounds({"height": (0, 4)})
        >>> swapped = ShuffledSpace(line, np.array([[2, 3, 0, 1]]))
        >>> swapped.to_world([0.5]).tolist(), swapped.from_world([2.5]).tolist()
        ([2.5], [0.5])
    """

    space: TaskSpace
    order: NDArray[np.intp]

    def __post_init__(self) -> None:
        count = self.order.shape[-1]
        if self.order.shape != (self.space.size, count) or np.any(np.sort(self.order) != np.arange(count)):
            raise ValueError(
                f"order {self.order.tolist()}: expected {self.space.size} rows, each a permutation of the "
                f"intervals 0 to {count - 1}"
            )
        crowded = (self.space.width > 0) & np.any(np.diff(self._edges) <= 0, axis=1)
        if np.any(crowded):
            dimension = self.space.dimensions[int(np.argmax(crowded))]
            raise ValueError(
                f"dimension {dimension.name!r} is too narrow to be cut into {count} intervals of "
                f"float32 numbers: {dimension.low} to {dimension.high}"
            )

    @classmethod
    def shuffle(cls, space: TaskSpace, rng: np.random.Generator, cuts: int = CUTS) -> "ShuffledSpace":
        """Return `space` with `cuts` intervals per dimension in random order.

        Raises:
            ValueError: if `cuts` is 0, or more than float32 resolves in some dimension.
        """
        if cuts < 1:
            raise ValueError(f"cuts = {cuts}: expected at least 1 interval per dimension")
        return cls(space, rng.permuted(np.tile(np.arange(cuts), (space.size, 1)), axis=1))

    def to_world(self, tasks: ArrayLike) -> Task:
        """Map the teacher's `tasks` (..., d) to the world's tasks."""
        return self._move(tasks, self.order)

    def from_world(self, tasks: ArrayLike) -> Task:
        """Map the world's `tasks` (..., d) to the teacher's tasks; inverse of `to_world`."""
        return self._move(tasks, np.argsort(self.order, axis=1))

    @cached_property
    def _edges(self) -> Task:
        """Edges of the intervals (d, cuts + 1), including the exact bounds of the space."""
        return np.linspace(self.space.low, self.space.high, self.order.shape[1] + 1, axis=1, dtype=np.float32)

    def _move(self, tasks: ArrayLike, order: NDArray[np.intp]) -> Task:
        values = np.asarray(tasks, dtype=np.float32)
        if not self.space.contains(values):
            raise ValueError(
                f"tasks {values.tolist()} exceed the shuffled space: bounds are "
                f"{self.space.low.tolist()} to {self.space.high.tolist()}"
            )
        rows = np.arange(self.space.size)
        old = np.sum(values[..., None] > self._edges[:, 1:-1], axis=-1)
        new = order[rows, old]
        low, high = self._edges[rows, old].astype(np.float64), self._edges[rows, old + 1]
        new_low, new_high = self._edges[rows, new], self._edges[rows, new + 1]
        share = (values - low) / np.where(high > low, high - low, 1.0)
        moved = new_low + share * (new_high.astype(np.float64) - new_low)
        first = np.where(new > 0, np.nextafter(new_low, new_high), new_low)
        inside: Task = np.clip(moved.astype(np.float32), first, new_high)
        return inside

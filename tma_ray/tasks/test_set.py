"""Fixed tasks on which every student of a benchmark is evaluated."""

from __future__ import annotations

import csv
import hashlib
import io
import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tma_ray.commands.arguments import check_kind, check_whole
from tma_ray.decoding import MOST_TEXT_BYTES, read_file
from tma_ray.tasks.space import Task, TaskSpace


@dataclass(frozen=True, eq=False)
class TestSet:
    """Named tasks in evaluation order.

    Attributes:
        name: what tables call it; part of the seed of every evaluation world.
        dimensions: names of the task's dimensions (d).
        tasks: float32 (n, d).
    """

    __test__ = False  # not a pytest class, whatever its name

    name: str
    dimensions: tuple[str, ...]
    tasks: Task

    def __post_init__(self) -> None:
        check_kind("tasks", self.tasks, np.ndarray, "an array (n, d)")
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
        """Names it; a run spec holds one, and is printed in messages."""
        return f"TestSet({self.name!r}, {', '.join(self.dimensions)}: {len(self)} tasks, {self.digest})"

    @property
    def digest(self) -> str:
        """Hash of dimensions and tasks: two sets of one name and other tasks never pass for each other."""
        content = ",".join(self.dimensions).encode() + np.ascontiguousarray(self.tasks).tobytes()
        return hashlib.sha256(content).hexdigest()[:16]

    @classmethod
    def grid(cls, name: str, space: TaskSpace, points: int) -> TestSet:
        """Returns the grid of `points` values per dimension, bounds included, first dimension slowest."""
        check_whole("points", points, 1)
        axes = [np.linspace(d.low, d.high, points) for d in space.dimensions]
        return cls(name, space.names, np.array(list(itertools.product(*axes)), dtype=np.float32))

    @classmethod
    def from_csv(cls, path: str | Path, name: str | None = None) -> TestSet:
        """Reads a test set: a header of dimension names, then one task a line.

        Raises:
            ValueError: a line that does not hold a task, or no text; the message names the file.
        """
        path = Path(path)
        text = read_file(path, MOST_TEXT_BYTES).decode()
        rows = [row for row in csv.reader(io.StringIO(text, newline="")) if row]
        if len(rows) < 2:
            raise ValueError(f"{path}: a test set has a header of dimension names and at least one task")
        tasks = [_parse(path, line, row, len(rows[0])) for line, row in enumerate(rows[1:], start=2)]
        return cls(name or path.stem, tuple(rows[0]), np.array(tasks, dtype=np.float32))

    def to_csv(self) -> str:
        """Returns the text that `from_csv` reads back to the same float32 tasks."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.dimensions)
        writer.writerows([[str(value) for value in task] for task in self.tasks])
        return text.getvalue()

    def check(self, domain: TaskSpace) -> None:
        """Refuses tasks that an environment with this valid domain cannot build.

        Raises:
            ValueError: other dimensions, or a task outside; the message names the first one.
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


def _parse(path: Path, line: int, row: list[str], size: int) -> list[float]:
    try:
        values = [float(value) for value in row]
    except ValueError as error:
        raise ValueError(f"{path}, line {line}: {row} is not a list of numbers") from error
    if len(values) != size or not np.all(np.isfinite(values)):
        raise ValueError(f"{path}, line {line}: expected {size} finite numbers, got {row}")
    return values

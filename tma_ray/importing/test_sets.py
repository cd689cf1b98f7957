"""Test sets of the original release, from the user's own copy, as the CSV files that ours are."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from tma_ray.array_files import load_array
from tma_ray.decoding import MOST_TEXT_BYTES, read_file
from tma_ray.importing.errors import DamagedSeedError, ImportRefusedError
from tma_ray.importing.teacher_history import DIMENSIONS, Floats, entries, matrix
from tma_ray.importing.unpickling import LARGEST_MEBIBYTES, load_pickle
from tma_ray.tasks import TestSet

ENDINGS: Final = (".csv", ".npy", ".pkl", ".pickle")
WIDEST: Final = 100
"""Most numbers in a row that may be a task."""


@dataclass(frozen=True)
class FoundTestSet:
    """A test set that was read.

    Attributes:
        path: of the file that it lay in.
        environment: our name of the environment that has such tasks.
        tests: the tasks, called after the file.
    """

    path: Path
    environment: str
    tests: TestSet


def read_test_sets(source: Path, *, by_position: bool = False) -> tuple[list[FoundTestSet], dict[str, str]]:
    """Returns the test sets of a file, or of all files of a folder, and why others are none, by name.

    A CSV file has a header of our names of the dimensions, in any order, or none; arrays, and pickles of
    arrays or lists, have a row for each task. Without names, numbers are in our order: the original's.

    Args:
        source: file or folder.
        by_position: take columns in our order whatever their header calls them.

    Raises:
        ImportRefusedError: the place does not exist, or holds no test set.
    """
    if source.is_dir():
        paths = sorted(path for path in source.rglob("*") if path.suffix in ENDINGS and path.is_file())
    elif source.is_file():
        paths = [source]
    else:
        raise ImportRefusedError(f"no file or folder {source}: give the one that holds the test sets")
    found, left_out = [], {}
    for path in paths:
        try:
            found.append(_read(path, by_position))
        except (OSError, ValueError) as error:
            left_out[path.name] = str(error)
    if not found:
        told = "; ".join(left_out.values()) or f"expected files that end with {', '.join(ENDINGS)}"
        raise ImportRefusedError(f"{source} holds no test set: {told}")
    names = [each.tests.name for each in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ImportRefusedError(f"{source} holds several files called {twice[0]}: import them one by one")
    return found, left_out


def write_test_sets(found: Sequence[FoundTestSet], output: Path) -> list[Path]:
    """Writes test sets as CSV files of a folder, which is made.

    Raises:
        ImportRefusedError: one is there already; nothing was written.
    """
    paths = [output / f"{each.tests.name}.csv" for each in found]
    for path in paths:
        if path.exists():
            raise ImportRefusedError(f"{path} is there already: choose another folder")
    output.mkdir(parents=True, exist_ok=True)
    for path, each in zip(paths, found, strict=True):
        path.write_text(each.tests.to_csv(), encoding="utf-8")
    return paths


def _read(path: Path, by_position: bool) -> FoundTestSet:
    names, tasks = _READERS[path.suffix](path) if path.suffix in _READERS else ((), None)
    if tasks is None:
        raise DamagedSeedError(f"{path}: expected a list of tasks, rows of equally many finite numbers")
    width = tasks.shape[1]
    environments = {len(dimensions): name for name, dimensions in DIMENSIONS.items()}
    if width not in environments:
        told = " or ".join(f"{size} ({name})" for size, name in environments.items())
        raise DamagedSeedError(f"{path} has tasks of {width} numbers; expected {told}")
    dimensions = DIMENSIONS[environments[width]]
    if names and not by_position:
        if sorted(names) != sorted(dimensions):
            raise DamagedSeedError(
                f"{path} calls its columns {', '.join(names)[:200]}: rename them to "
                f"{', '.join(dimensions)}, or say --by-position if they are in this order"
            )
        tasks = tasks[:, [names.index(name) for name in dimensions]]
    tests = TestSet(path.stem, dimensions, tasks.astype(np.float32))
    return FoundTestSet(path, environments[width], tests)


def _of_csv(path: Path) -> tuple[tuple[str, ...], Floats | None]:
    rows = [row for row in csv.reader(io.StringIO(read_file(path, MOST_TEXT_BYTES).decode())) if row]
    try:
        return (), _table([[float(value) for value in row] for row in rows])
    except ValueError:
        try:
            names = tuple(name.strip() for name in rows[0])
            return names, _table([[float(value) for value in row] for row in rows[1:]])
        except ValueError:
            return (), None


def _of_array(path: Path) -> tuple[tuple[str, ...], Floats | None]:
    return (), _table(load_array(path))


def _of_pickle(path: Path) -> tuple[tuple[str, ...], Floats | None]:
    return (), _table(load_pickle(path, LARGEST_MEBIBYTES))


def _table(value: Any) -> Floats | None:
    first = value[0] if isinstance(value, list | tuple | np.ndarray) and len(value) else None
    width = entries(first)
    return matrix(value, width) if 0 < width <= WIDEST else None


_READERS: Final[dict[str, Callable[[Path], tuple[tuple[str, ...], Floats | None]]]] = {
    ".csv": _of_csv,
    ".npy": _of_array,
    ".pkl": _of_pickle,
    ".pickle": _of_pickle,
}

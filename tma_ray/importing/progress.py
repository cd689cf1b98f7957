"""The training progress of a seed: the progress file of either student."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from tma_ray.decoding import MOST_TEXT_BYTES, read_file
from tma_ray.importing.errors import DamagedSeedError
from tma_ray.importing.folders import SeedFolder


@dataclass(frozen=True)
class Window:
    """One line of a progress file.

    Attributes:
        step: environment steps at its end.
        mean_return: of training episodes, as the file has it.
        std_return: of the same; NaN where the file has none.
        mean_length: of the same, environment steps.
        evaluated: whether the student was evaluated at its end.
    """

    step: int
    mean_return: float
    std_return: float
    mean_length: float
    evaluated: bool


@dataclass(frozen=True)
class Progress:
    """Content of a progress file.

    Attributes:
        windows: its whole lines.
        seed: of the run.
        budget: environment steps that were planned; None where no file says.
        hyperparameters: numbers and switches of the student's configuration.
        cut: whether the file ends inside a line.
    """

    windows: tuple[Window, ...]
    seed: int
    budget: int | None
    hyperparameters: Mapping[str, Any]
    cut: bool


@dataclass(frozen=True)
class _Columns:
    """Names of the columns of a file."""

    step: str
    mean_return: str
    std_return: str
    mean_length: str
    test_return: str


_SAC = _Columns("Epoch", "AverageEpRet", "StdEpRet", "EpLen", "AverageTestEpRet")
_PPO = _Columns("misc/total_timesteps", "eprewmean", "", "eplenmean", "eval_eprewmean")


def read_progress(folder: SeedFolder) -> Progress:
    """Returns what the progress file of a seed tells, and its configuration if it is one of SAC.

    Raises:
        DamagedSeedError: a file is missing or damaged other than by a last line that was not finished.
    """
    if folder.student == "sac":
        path = folder.path / "config.json"
        config = _config(path)
        per_epoch = _whole(config, "steps_per_epoch", path)
        windows, cut = _read(folder.progress_file, "\t", _SAC, per_epoch)
        epochs = config.get("epochs")
        budget = epochs * per_epoch if type(epochs) is int and epochs > 0 else None
        return Progress(windows, _whole(config, "seed", path, least=0), budget, _plain(config), cut)
    seed = folder.seed_of_name
    if seed is None:
        raise DamagedSeedError(
            f"{folder.path} does not end with _s and the seed, as folders of PPO do: rename it"
        )
    windows, cut = _read(folder.progress_file, ",", _PPO, 1)
    return Progress(windows, seed, None, {}, cut)


def _read(path: Path, delimiter: str, columns: _Columns, unit: int) -> tuple[tuple[Window, ...], bool]:
    """Returns the windows of a table whose steps count `unit` environment steps, and whether it was cut."""
    try:
        text = read_file(path, MOST_TEXT_BYTES).decode()
    except (OSError, ValueError) as error:
        raise DamagedSeedError(f"{path} cannot be read ({type(error).__name__}): copy it again") from error
    lines = [line for line in csv.reader(text.splitlines(), delimiter=delimiter) if line]
    header = lines[0] if lines else []
    missing = [name for name in vars(columns).values() if name and name not in header]
    if missing:
        raise DamagedSeedError(f"{path} has no column {', '.join(missing)}: copy it again")
    cut = len(lines) > 1 and not _is_whole(lines[-1], header)
    rows = lines[1 : -1 if cut else None]
    windows = tuple(_window(path, row, number, header, columns, unit) for number, row in enumerate(rows, 2))
    if any(later.step <= window.step for window, later in pairwise(windows)):
        raise DamagedSeedError(f"{path}: its steps do not rise; keep the lines of one training only")
    return windows, cut


def _is_whole(row: list[str], header: list[str]) -> bool:
    try:
        return len(row) == len(header) and all(value == "" or float(value) is not None for value in row)
    except ValueError:
        return False


def _window(
    path: Path, row: list[str], number: int, header: list[str], columns: _Columns, unit: int
) -> Window:
    if not _is_whole(row, header):
        raise DamagedSeedError(f"{path}, line {number}: expected {len(header)} numbers; copy the file again")
    values = {name: float(value) if value else math.nan for name, value in zip(header, row, strict=True)}
    step = values[columns.step] * unit
    if not (math.isfinite(step) and step > 0 and step == int(step)):
        raise DamagedSeedError(
            f"{path}, line {number}: {columns.step} = {values[columns.step]}: expected a step"
        )
    return Window(
        step=int(step),
        mean_return=values[columns.mean_return],
        std_return=values[columns.std_return] if columns.std_return else math.nan,
        mean_length=values[columns.mean_length],
        evaluated=math.isfinite(values[columns.test_return]),
    )


def _config(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(read_file(path, MOST_TEXT_BYTES))
    except FileNotFoundError as error:
        raise DamagedSeedError(f"{path} is missing, which says steps_per_epoch: copy it too") from error
    except (OSError, ValueError, RecursionError) as error:
        raise DamagedSeedError(f"{path} cannot be read ({type(error).__name__}): copy it again") from error
    if not isinstance(content, dict):
        raise DamagedSeedError(f"{path} holds no configuration: copy it again")
    return content


def _whole(config: Mapping[str, Any], name: str, path: Path, least: int = 1) -> int:
    value = config.get(name)
    if type(value) is not int or value < least:
        raise DamagedSeedError(
            f"{path}: {name}: expected a whole number of at least {least}; copy the file again"
        )
    return value


def _plain(config: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what says how the student learns, alike for all seeds of an experiment."""
    kinds = (bool, int, float)
    return {
        name: value
        for name, value in sorted(config.items())
        if isinstance(value, kinds) and "seed" not in name and math.isfinite(value)
    }

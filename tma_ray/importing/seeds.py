"""One seed as it is imported: its progress file and its teacher history, checked against each other."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tma_ray.importing.errors import DamagedSeedError
from tma_ray.importing.folders import SeedFolder
from tma_ray.importing.progress import Progress, Window
from tma_ray.importing.teacher_history import TeacherHistory, read_teacher_history

LONGEST_EPISODE = 2000
"""Environment steps after which the original cuts an episode; the history lacks one that runs at the end."""

TOLERANCE = 0.01
"""By which share of the training the episodes of the history may fall short besides."""


@dataclass(frozen=True, eq=False)
class ImportedSeed:
    """Content of a seed as it is imported.

    Attributes:
        folder: where it lies.
        progress: what its progress file tells.
        windows: of it, those that the history confirms.
        history: what its teacher recorded, as far as the last window.
        tests: tasks of an evaluation.
        budget: environment steps that were planned.
        problem: why it did not get to its end, empty if it did.
        digest: of its files' content and of what it is a seed of.
    """

    folder: SeedFolder
    progress: Progress
    windows: tuple[Window, ...]
    history: TeacherHistory
    tests: int
    budget: int
    problem: str
    digest: str

    @property
    def evaluated(self) -> list[int]:
        """Steps of its evaluations."""
        return [window.step for window in self.windows if window.evaluated]


def read_seed(folder: SeedFolder, progress: Progress, budget: int, largest_mebibytes: int) -> ImportedSeed:
    """Returns what can be imported of a seed.

    A seed that ended early, or whose files end at different evaluations, is imported up to the last one
    that all have whole, with its `problem`.

    Raises:
        DamagedSeedError: its files do not fit together, or they hold no complete evaluation.
    """
    history = read_teacher_history(folder.history_file, folder.setting.environment, largest_mebibytes)
    asked = sum(window.evaluated for window in progress.windows)
    if not asked:
        raise DamagedSeedError(f"{folder.progress_file} has no evaluation in it: nothing to import")
    tests = _tests(history, asked, folder)
    recorded = len(history.test_episodic_returns) // tests
    windows = _first(progress.windows, min(asked, recorded))
    ends = np.cumsum(history.lengths)
    last = windows[-1].step
    short = last - (int(ends[-1]) if len(ends) else 0)
    most = LONGEST_EPISODE + TOLERANCE * last
    if short > most or (recorded == asked and -short > most):
        raise DamagedSeedError(
            f"{folder.history_file} has episodes of {last - short:,} steps, and {folder.progress_file.name} "
            f"goes to {last:,}: they are not of one training; copy both again"
        )
    problem = _problem(progress, asked, recorded, last, budget)
    return ImportedSeed(
        folder, progress, windows, _until(history, ends, last), tests, budget, problem, _digest(folder)
    )


def _problem(progress: Progress, asked: int, recorded: int, last: int, budget: int) -> str:
    """Returns why a seed did not get to its end, in words; empty if it did."""
    reasons = []
    if progress.cut:
        reasons.append("the last line of its progress file is not whole")
    if recorded != asked and not (progress.cut and recorded == asked + 1):
        reasons.append(f"its progress file has {asked} evaluations and its teacher history has {recorded}")
    if last < budget:
        reasons.append(f"it ends after {last:,} of {budget:,} steps")
    return "; ".join(reasons)


def _tests(history: TeacherHistory, evaluations: int, folder: SeedFolder) -> int:
    """Returns how many tasks an evaluation has: after so many, the test tasks begin again."""
    count, period = len(history.test_episodic_returns), _period(history)
    if period == 0 or count == 0 or (period == count and evaluations != 1):
        raise DamagedSeedError(
            f"{folder.history_file} has {count:,} returns on {len(history.test_tasks):,} test tasks, and "
            f"{folder.progress_file.name} {evaluations} evaluations: one is cut off; copy both again"
        )
    return period


def _period(history: TeacherHistory) -> int:
    """Returns after how many test tasks they begin again; 0 if the returns are not complete evaluations."""
    tasks, count = history.test_tasks, len(history.test_episodic_returns)
    if not len(tasks) or count % len(tasks):
        return 0
    if count != len(tasks):
        return len(tasks)  # one evaluation's are listed
    again = 1 + np.flatnonzero((tasks[1:] == tasks[0]).all(axis=1))
    for period in again:
        if count % period == 0 and np.array_equal(tasks[period:], tasks[:-period]):
            return int(period)
    return count


def _first(windows: tuple[Window, ...], evaluations: int) -> tuple[Window, ...]:
    """Returns the windows up to the one with that evaluation, and those after it if it is the last."""
    places = [place for place, window in enumerate(windows) if window.evaluated]
    return windows if evaluations == len(places) else windows[: places[evaluations - 1] + 1]


def _until(history: TeacherHistory, ends: NDArray[np.float64], step: int) -> TeacherHistory:
    count = int(np.searchsorted(ends, step, side="right"))
    return TeacherHistory(
        history.tasks[:count],
        history.episodic_returns[:count],
        history.lengths[:count],
        history.test_tasks,
        history.test_episodic_returns,
        history.test_lengths,
        history.bounds,
        history.samples,
        history.teacher,
    )


def _digest(folder: SeedFolder) -> str:
    found = hashlib.sha256(repr(_identity(folder)).encode())
    for path in (folder.progress_file, folder.history_file):
        with path.open("rb") as file:
            found.update(hashlib.file_digest(file, "sha256").digest())
    return found.hexdigest()


def _identity(folder: SeedFolder) -> tuple[str, ...]:
    setting = folder.setting
    told = "none" if setting.teacher == "random" else setting.level
    return (*setting.place, setting.embodiment, setting.teacher, told, folder.student)

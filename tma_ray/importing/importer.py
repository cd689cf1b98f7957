"""Imports a folder of the original release's results; one bad seed never loses the rest."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

from tma_ray.importing.errors import ImportRefusedError
from tma_ray.importing.folders import SeedFolder, find_seeds
from tma_ray.importing.progress import Progress, read_progress
from tma_ray.importing.seeds import read_seed
from tma_ray.importing.unpickling import LARGEST_MEBIBYTES
from tma_ray.importing.writing import ImportWriter, open_empty, write_summary

Seeds: TypeAlias = Sequence[tuple[SeedFolder, Progress]]

_DAMAGE: Final = (OSError, ValueError, TypeError, LookupError, ArithmeticError, MemoryError)
"""What files that are not what they should be may lead to."""


@dataclass(frozen=True)
class ImportSummary:
    """Outcome of an import.

    Attributes:
        finished: runs that got to their end.
        unfinished: why others did not, by name of the seed; they are in the root as failed runs.
        left_out: why seeds are not in the root, by name.
        copies: seeds whose files are those of another one, which is in the root once, by name.
        notes: what of a seed could not be imported, by name.
        ignored: folders whose names ask to be passed by.
    """

    finished: int
    unfinished: dict[str, str]
    left_out: dict[str, str]
    copies: dict[str, str]
    notes: dict[str, list[str]]
    ignored: tuple[str, ...]


def import_results(
    source: Path,
    root: str | Path,
    largest_mebibytes: int = LARGEST_MEBIBYTES,
    track: Callable[[Seeds], Iterable[tuple[SeedFolder, Progress]]] = iter,
) -> ImportSummary:
    """Writes the seeds of a folder as the runs of a new results root, marked as Box2D's.

    The budget of a run is that of its configuration, or else the most steps of any seed of the same
    environment and challenge.

    Args:
        source: folder with any number of experiments.
        root: an empty folder, or an ``s3://`` or ``gs://`` address, that becomes the results root.
        largest_mebibytes: size over which a pickle is refused, MiB.
        track: shows how far a loop is.

    Raises:
        ImportRefusedError: nothing can be imported, or `root` is not empty; nothing was written.
    """
    store = open_empty(root)
    found = find_seeds(source)
    left_out = dict(found.problems)
    known = _read_all(found.seeds, left_out)
    budgets = _budgets(known)
    writer = ImportWriter(store)
    budgeted = (
        (folder, progress, progress.budget or budgets[folder.setting.place])
        for folder, progress in track(known)
    )
    unfinished, copies = _write_all(budgeted, writer, largest_mebibytes, left_out)
    if not writer.runs:
        raise ImportRefusedError(
            f"no seed of {source} can be imported: "
            + "; ".join(f"{name}: {reason}" for name, reason in left_out.items())
        )
    writer.finish()
    write_summary(store, source.resolve().name, writer, left_out)
    return ImportSummary(
        finished=len(writer.runs) - len(unfinished),
        unfinished=unfinished,
        left_out=left_out,
        copies=copies,
        notes={name: notes for name, notes in writer.notes.items() if notes},
        ignored=found.ignored,
    )


def _write_all(
    seeds: Iterable[tuple[SeedFolder, Progress, int]],
    writer: ImportWriter,
    largest_mebibytes: int,
    left_out: dict[str, str],
) -> tuple[dict[str, str], dict[str, str]]:
    """Writes seeds with their budgets; returns why some are unfinished, and of what others are copies."""
    unfinished: dict[str, str] = {}
    copies: dict[str, str] = {}
    for folder, progress, budget in seeds:
        try:
            run = writer.prepare(read_seed(folder, progress, budget, largest_mebibytes))
        except _DAMAGE as error:
            left_out[folder.name] = _said(error)
            continue
        copy_of = writer.write(run)
        if copy_of:
            copies[folder.name] = copy_of
        elif run.seed.problem:
            unfinished[folder.name] = run.seed.problem
    return unfinished, copies


def _read_all(folders: Iterable[SeedFolder], left_out: dict[str, str]) -> list[tuple[SeedFolder, Progress]]:
    known = []
    for folder in folders:
        try:
            known.append((folder, read_progress(folder)))
        except _DAMAGE as error:
            left_out[folder.name] = _said(error)
    return known


def _budgets(known: Iterable[tuple[SeedFolder, Progress]]) -> dict[tuple[str, str], int]:
    """Returns the most steps of any seed of an environment and challenge."""
    budgets: dict[tuple[str, str], int] = defaultdict(int)
    for folder, progress in known:
        last = max((window.step for window in progress.windows), default=0)
        budgets[folder.setting.place] = max(budgets[folder.setting.place], progress.budget or last)
    return budgets


def _said(error: BaseException) -> str:
    text = str(error)
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__}: {text}"

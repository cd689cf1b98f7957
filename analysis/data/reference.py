"""References for comparisons: the baseline teacher Random, teachers of a core, and published results."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from analysis.data.columns import CELL_COLUMNS
from tma_ray.benchmark import paper_results
from tma_ray.results import BOX2D, Store, read_published
from tma_ray.tasks import KnowledgeLevel

BASELINE = "random"  # teacher that all others are tested against (paper, section 5)

NO_BASELINE = "no Random to compare with"  # reason for a missing test: Random has no runs


def is_baseline(teacher: str) -> bool:
    """Return True if `teacher` is the Random baseline."""
    return teacher.lower() == BASELINE


def baseline_rows(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of Random."""
    return rows[rows["teacher"].isin(list(filter(is_baseline, rows["teacher"].unique())))]


def random_cells(cells: pd.DataFrame) -> dict[str, tuple[str, ...]]:
    """Return the values of `CELL_COLUMNS` by cell name, for Random's cells at the highest knowledge level.

    Only cells of core campaigns count. A cell is named after its challenge, followed by ``/body`` if the
    challenge has several bodies and preceded by ``environment/`` if another environment has a cell of the
    same name.
    """
    rows = baseline_rows(cells[cells["core"]])
    keys = {tuple(map(str, row)) for row in rows[CELL_COLUMNS].itertuples(index=False)}
    rising = sorted(keys, key=lambda key: (key[:-1], KnowledgeLevel(key[-1]).rank))
    highest = {key[:-1]: key for key in rising}.values()
    bodies = Counter(key[:2] for key in highest)
    named = [(key[1] if bodies[key[:2]] == 1 else f"{key[1]}/{key[2]}", key) for key in highest]
    alike = Counter(name for name, _ in named)
    return {name if alike[name] == 1 else f"{key[0]}/{name}": key for name, key in named}


def core_of(runs: pd.DataFrame) -> frozenset[str]:
    """Return the core teachers among the runs of a comparison, or all teachers if there is no core."""
    core = runs["core"].to_numpy(bool) if "core" in runs else np.zeros(len(runs), bool)
    return frozenset(map(str, runs["teacher"][core if core.any() else ~core]))


def baseline_runs(
    group: pd.DataFrame, alike: pd.DataFrame, apart: Sequence[str] = ("expert_knowledge",)
) -> pd.DataFrame:
    """Return the runs of Random against which the teachers of one comparison are tested.

    Random uses no expert knowledge, and the experiment makes no difference to it. A comparison without runs
    of Random uses those of another comparison, of the same experiment if possible, and of the lowest level.

    Args:
        group: rows of the comparison.
        alike: rows that agree with it in all columns but `apart`.
        apart: columns of comparisons that make no difference to Random.
    """
    in_group, randoms = baseline_rows(group), baseline_rows(alike)
    if len(in_group) or randoms.empty:
        return in_group
    first, columns = group.iloc[0], list(apart)
    others = [column for column in apart if column != "expert_knowledge"]

    def distance(key: tuple[Any, ...]) -> tuple[Any, ...]:
        values = dict(zip(columns, key, strict=True))
        differs = (values[column] != first[column] for column in others)
        return (*differs, KnowledgeLevel(values["expert_knowledge"]).rank, *map(str, key))

    keys = randoms[columns].drop_duplicates().itertuples(index=False, name=None)
    nearest = min(keys, key=distance)
    return randoms[(randoms[columns] == list(nearest)).all(axis=1)]


PAPER = "paper-2021"  # name of the baseline that holds the paper's tables

PAPER_ENGINE = BOX2D  # simulator of the paper's worlds; this package uses Chipmunk

PAPER_STEPS = 20_000_000  # training steps of each run in the paper's tables


def paper_frame() -> pd.DataFrame:
    """Return the paper's tables, one row per entry.

    Returns:
        environment, challenge, expert_knowledge, embodiments and students (tuples of those pooled),
        teacher, n, mastered_percent_mean, mastered_percent_std, doubt (why the entry may be a slip; empty
        for most), steps, engine.
    """
    rows = [asdict(entry) | {"expert_knowledge": entry.expert_knowledge.value} for entry in paper_results()]
    named = {"seeds": "n", "mean": "mastered_percent_mean", "std": "mastered_percent_std"}
    return pd.DataFrame(rows).rename(columns=named).assign(steps=PAPER_STEPS, engine=PAPER_ENGINE)


def published_frame(store: Store) -> pd.DataFrame:
    """Return the published results of a store, with the columns of `paper_frame`."""
    frame: pd.DataFrame = read_published(store).to_pandas()
    for column in ("embodiments", "students"):
        frame[column] = pd.Series([tuple(names) for names in frame[column]], index=frame.index, dtype=object)
    return frame

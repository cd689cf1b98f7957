"""Results that others published, in the shape of ours: to be set beside them, never pooled."""

from __future__ import annotations

from dataclasses import asdict

import pandas as pd

from tma_ray.benchmark import paper_results
from tma_ray.results import BOX2D, Store, read_published

PAPER = "paper-2021"
"""Name of the tables of the paper among the baselines."""

PAPER_ENGINE = BOX2D
"""What simulated the paper's worlds; ours are Chipmunk's."""

PAPER_STEPS = 20_000_000
"""Training steps behind the paper's tables."""


def paper_frame() -> pd.DataFrame:
    """Returns the paper's tables, one row per entry.

    Returns:
        environment, challenge, expert_knowledge, embodiments and students (tuples of those pooled),
        teacher, n, mastered_percent_mean, mastered_percent_std, doubt (why the entry may be a slip; empty
        for most), steps, engine.
    """
    rows = [
        asdict(result) | {"expert_knowledge": result.expert_knowledge.value} for result in paper_results()
    ]
    named = {"seeds": "n", "mean": "mastered_percent_mean", "std": "mastered_percent_std"}
    return pd.DataFrame(rows).rename(columns=named).assign(steps=PAPER_STEPS, engine=PAPER_ENGINE)


def published_frame(store: Store) -> pd.DataFrame:
    """Returns published results that lie in a folder or object store, in the columns of `paper_frame`.

    Raises:
        FileNotFoundError: there are none.
        ValueError: they have other columns.
    """
    frame: pd.DataFrame = read_published(store).to_pandas()
    for column in ("embodiments", "students"):
        frame[column] = pd.Series([tuple(names) for names in frame[column]], index=frame.index, dtype=object)
    return frame

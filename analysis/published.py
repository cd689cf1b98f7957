"""Results that others published, in the shape of ours: to be set beside them, never pooled."""

from __future__ import annotations

from dataclasses import asdict

import pandas as pd

from tma_ray.benchmark import paper_results

PAPER = "paper-2021"
"""Name of the tables of the paper among the baselines."""

PAPER_ENGINE = "Box2D"
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

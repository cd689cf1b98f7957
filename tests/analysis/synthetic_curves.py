"""Synthetic learning curves of runs, in the format of `evaluations_at`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from synthetic_pools import cell

from analysis.measures.pooling import pool_runs

MILLION = 1_000_000

SKILL = {
    "random": 0.36,
    "adr": 0.2,
    "alp_gmm": 0.55,
    "covar_gmm": 0.5,
    "goal_gan": 0.44,
    "riac": 0.46,
    "setter_solver": 0.34,
    "spdl": 0.35,
}


def curve_runs(
    teachers: Sequence[str] = tuple(SKILL),
    seeds: int = 8,
    every: int = MILLION,
    head_start: Mapping[str, float] | None = None,  # share of the training saved, by level
    **changes: Any,
) -> pd.DataFrame:
    """Return rows of `pool_runs` for synthetic runs of 20 million steps, one per run and step."""
    cells, values = [], []
    steps = np.arange(0, 20 * MILLION + 1, every)
    for level, saved in (head_start or {"low": 0.0}).items():
        for teacher in teachers:
            for seed in range(seeds):
                settings = {"expert_knowledge": level, "steps": 20.0 * MILLION} | changes
                row = cell(teacher, seed, 0.0, **settings)
                rng = np.random.default_rng([seed, *teacher.encode(), *level.encode()])
                end = 100 * SKILL.get(teacher, 0.4) + rng.normal(0, 6)
                learnt = 1 - np.exp(-4 * (steps / (20 * MILLION) + saved))
                mastered = np.clip(end * learnt + rng.normal(0, 1.5, len(steps)), 0, 100)
                mastered[0] = 0 if not saved else mastered[0]
                rows = {"run_id": row["run_id"], "step": steps, "mastered_percent": mastered}
                values.append(pd.DataFrame(rows | {"training_return": 4 * mastered - 60}))
                cells.append({name: row[name] for name in row if name not in ("mastered_percent", "step")})
    return pool_runs(pd.DataFrame(cells), pd.concat(values, ignore_index=True))

"""Effect of the precision of matrix products on learning, compared with "highest", without Ray.

    python benchmarks/precision.py --student sac --precision medium --device cuda --processes 16 \
        --results build/precision

Trains a cohort of 16 runs under Random on the easy task space, 8 seeds at each precision, 2 million steps
each. One call takes nine minutes at most; an interrupted or unfinished call is continued by the next. Prints
the progress of every seed, and a table of the differences at the last evaluation common to all seeds, with
Welch's and a bootstrap 95 % interval; writes them to ``precision.json`` in the results root.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pools import execute, parser
from sac_learning import curves
from scipy import stats

from analysis.statistics import welch
from tma_ray.campaign.plan import CampaignSpec, Plan
from tma_ray.runs import Cell, Schedule
from tma_ray.students.hyperparameters import MatmulPrecision
from tma_ray.support.quantities import COUNT

REFERENCE = MatmulPrecision.HIGHEST

EVALUATIONS = 8
"""Number of evenly spaced evaluations after the first step."""

MEASURES = {"mastered": "mastered tasks, %", "episodic_return": "mean return"}


def plan(student: str, precision: str, seeds: int, steps: int) -> Plan:
    """Return the plan of runs with both precisions, the reference first."""
    cells = tuple(
        Cell(challenge="easy", student=student, student_hyperparameters={"matmul_precision": each})
        for each in (REFERENCE.value, precision)
    )
    interval = max(1, steps // EVALUATIONS)
    schedule = Schedule(steps, interval, steps, training_window=interval)
    return CampaignSpec("precision", cells, tuple(range(seeds)), schedule).plan()


def differences(table: pd.DataFrame, precision: str) -> list[dict[str, Any]]:
    """Return differences from the reference by measure, at the last step that all runs have reached.

    Args:
        table: result of `sac_learning.curves`.
        precision: precision to compare.
    """
    step = int(table.groupby("run_id", observed=True).step.max().min())
    last = table[table.step == step]
    chosen = last.student.astype(str).str.contains(f"matmul_precision={precision}")
    rows = []
    for measure in MEASURES:
        sample, reference = (last[flag].set_index("run_id")[measure] for flag in (chosen, ~chosen))
        row = {"measure": measure, "step": step, "seeds": (len(reference), len(sample))}
        row |= {REFERENCE.value: float(reference.mean()), precision: float(sample.mean())}
        if min(len(sample), len(reference)) > 1:
            test = welch(sample, reference)
            row |= {"difference": test.difference, "welch": (test.low, test.high), "p": test.p}
            row |= {"bootstrap": bootstrap(sample.to_numpy(), reference.to_numpy())}
        rows.append(row)
    return rows


def bootstrap(sample: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Return a bootstrap 95 % interval of the difference of two means."""
    found = stats.bootstrap(
        (sample, reference),
        lambda one, other, axis: np.mean(one, axis=axis) - np.mean(other, axis=axis),
        n_resamples=10_000,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(found.low), float(found.high)


def show(rows: list[dict[str, Any]], precision: str) -> str:
    """Return the differences as a Markdown table."""
    head = (
        f"at {rows[0]['step']:,} steps",
        REFERENCE.value,
        precision,
        "difference",
        "Welch",
        "bootstrap",
        "p",
    )
    lines = [f"| {' | '.join(head)} |", f"| {' | '.join('---' for _ in head)} |"]
    for row in rows:
        means = f"{row[REFERENCE.value]:.1f} | {row[precision]:.1f}"
        ends = [
            f"[{low:+.1f}, {high:+.1f}]" for low, high in (row[k] for k in ("welch", "bootstrap") if k in row)
        ]
        found = f"{row['difference']:+.1f} | {' | '.join(ends)} | {row['p']:.2f}" if ends else " | | |"
        lines.append(f"| {MEASURES[row['measure']]} | {means} | {found} |")
    return "\n".join(lines)


def main() -> int:
    """Execute missing runs, and print and write the differences."""
    options: argparse.ArgumentParser = parser(str(__doc__))
    options.set_defaults(cohort=16)
    options.add_argument("--student", default="sac", choices=("sac", "ppo"), help="who learns")
    others = [each.value for each in MatmulPrecision if each is not REFERENCE]
    options.add_argument("--precision", default="medium", choices=others, help="compared with highest")
    options.add_argument("--seeds", type=int, default=8, help="of each precision")
    options.add_argument("--steps", type=COUNT, default=2_000_000, help="of each run")
    given = options.parse_args()
    if not given.cohort:
        options.error("--cohort 0: alone, students on a processor without AMX ignore the precision")
    execute(plan(given.student, given.precision, given.seeds, given.steps), given)
    table = curves(given.results)
    print(table.pivot(index=["student", "seed"], columns="step", values="mastered").round(0).to_string())
    rows = differences(table, given.precision)
    Path(given.results, "precision.json").write_text(json.dumps(rows, indent=1))
    print(show(rows, given.precision))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

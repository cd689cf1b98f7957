"""Core-hours needed to distinguish two teachers, by cell and set of cells (docs/trials.md).

    python benchmarks/trial_cells.py > benchmarks/measured/trial_cells.csv

Cells are those of trials against a release, lite-2 by default; for lite-2, Parkour is read from the
evaluations of the pilot of docs/long_runs.md.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import sys
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pilot import areas, read
from scipy import stats

from analysis.baselines import Baseline, find_baseline
from analysis.data.columns import CELL_COLUMNS
from analysis.data.reference import random_cells
from analysis.measures.run_measures import run_measures
from analysis.statistics import stratum_weights
from analysis.statistics.power import POWER
from analysis.statistics.samples import TAIL
from analysis.trials.design import in_cell, make_design, released_runs, setting_of
from analysis.trials.rules import TrialVerdict, simulate
from tma_ray.benchmark import challenges_of

PILOT = Path(__file__).parent / "measured" / "parkour_pilot.csv"

RELEASE, STUDENT = "lite-2", "ppo:preset=decisive"

TRIALS = 1_000
"""Number of simulated trials of each teacher."""

SAVED, LOST = 0.2, 1.0
"""Smallest saving of core-hours, as a share, and largest loss of decided trials, in points, with which a set
of fewer cells is recommended."""

MILLIONS = 2, 3, 4, 5, 6
"""Budgets evaluated in Parkour, in millions of steps; Stump Tracks has 2 million."""

QUANTILES = float(stats.norm.ppf(TAIL) + stats.norm.ppf(POWER))
"""Difference that is detected with power `POWER`, in standard errors."""

Samples = Mapping[str, NDArray[np.float64]]


class Cell(NamedTuple):
    """Results of one cell, with the cost of a run.

    Attributes:
        name: challenge or environment, body and budget.
        challenge: environment and challenge; cells of one challenge share its weight.
        hours: core-hours of a run.
        samples: `angle` of mastered % over training, rad, of the runs of each teacher.
    """

    name: str
    challenge: tuple[str, str]
    hours: float
    samples: Samples


def core_hours(body: str, steps: int) -> float:
    """Return the core-hours of a run's training, by the speeds of `tma-ray plan`."""
    text = resources.files("tma_ray.campaign").joinpath("speeds.csv").read_text()
    speeds = {
        (row["student"], row["embodiment"]): row["training"] for row in csv.DictReader(text.splitlines())
    }
    return steps / float(speeds[STUDENT, body]) / 3600


def angle(percent: pd.Series) -> NDArray[np.float64]:
    """Return the arcsine of the square root of percentages, the scale of trials."""
    return np.arcsin(np.sqrt(percent.to_numpy(float) / 100))


def released(baseline: Baseline, at: int | None = None) -> list[Cell]:
    """Return the cells of trials against a release, with the runs of its core.

    Args:
        baseline: release.
        at: environment steps after which runs are measured, without challenges that reset the student at
            shares of its budget; None for the budgets of all.
    """
    frames = baseline.frames()
    runs = frames.cells[frames.cells["core"]].astype(dict.fromkeys([*CELL_COLUMNS, "teacher"], str))
    measures = run_measures(frames, at, training=False).dropna(subset=["mastered_area"])
    runs = runs.merge(measures[["run_id", "mastered_area"]], on="run_id")
    cells = []
    for name, key in random_cells(frames.cells).items():
        rows = in_cell(runs, key)
        environment, challenge, body, *_ = key
        if at and challenges_of(environment)[challenge].resets:
            continue
        samples = {str(teacher): angle(own["mastered_area"]) for teacher, own in rows.groupby("teacher")}
        hours = core_hours(body, at or int(rows["steps"].iloc[0]))
        cells.append(Cell(name, (environment, challenge), hours, samples))
    return cells


def parkour() -> list[Cell]:
    """Return the cells of the pilot in Parkour, one per body and budget of `MILLIONS`."""
    evaluations = read(PILOT)
    evaluations = evaluations[evaluations["student"] == STUDENT]
    return [
        Cell(
            f"Parkour, {body}, {millions} million steps",
            ("parkour", "original"),
            core_hours(str(body), 10**6 * millions),
            {str(name): angle(own["area"]) for name, own in rows.groupby("teacher")},
        )
        for millions in MILLIONS
        for body, rows in areas(evaluations, 10**6 * millions).groupby("embodiment")
        if rows.groupby("teacher").size().min() > 1
    ]


def cell_weights(cells: Sequence[Cell]) -> NDArray[np.float64]:
    """Return the weights of cells: equal for challenges, and for the bodies of a challenge."""
    weights = np.array(stratum_weights([cell.challenge for cell in cells]))
    return np.asarray(weights / weights.sum())


def common_teachers(cells: Sequence[Cell]) -> list[str]:
    """Return the teachers with runs in all cells."""
    return sorted(set.intersection(*(set(cell.samples) for cell in cells)))


def decisiveness(cells: Sequence[Cell]) -> tuple[float, float]:
    """Return signal to noise of the mean over cells, and the core-hours of a seed in all cells.

    Weights are equal for challenges, and for the bodies of a challenge. The variance between teachers is
    corrected for the variance of their seeds.
    """
    weights, teachers = cell_weights(cells), common_teachers(cells)
    means = effects(cells, teachers)
    noise = added = 0.0
    for weight, cell in zip(weights, cells, strict=True):
        samples = [cell.samples[name] for name in teachers]
        squares = sum(float(((sample - sample.mean()) ** 2).sum()) for sample in samples)
        variance = weight**2 * squares / sum(sample.size - 1 for sample in samples)
        noise += variance
        added += variance * float(np.mean([1 / sample.size for sample in samples]))
    signal = max(float(means.var(ddof=1)) - added, 0.0)
    return float(np.sqrt(signal / noise)) if signal else 0.0, sum(cell.hours for cell in cells)


def effects(cells: Sequence[Cell], teachers: Sequence[str]) -> NDArray[np.float64]:
    """Return the weighted means of teachers over cells."""
    means = np.array([[cell.samples[name].mean() for cell in cells] for name in teachers])
    return np.asarray(means @ cell_weights(cells))


def row(name: str, cells: Sequence[Cell], everything: Sequence[Cell] = ()) -> dict[str, Any]:
    """Return a row of the table: a cell or a set of cells, compared with all of them."""
    ratio, hours = decisiveness(cells)
    teachers = common_teachers([*cells, *everything])
    agreement = np.nan
    if 0 < len(everything) > len(cells):
        agreement = np.corrcoef(effects(cells, teachers), effects(everything, teachers))[0, 1]
    return {
        "cells": name,
        "teachers": len(teachers),
        "core-hours a seed": round(hours, 3),
        "signal to noise": round(ratio, 2),
        "core-hours to tell two apart": round(2 * hours * (QUANTILES / ratio) ** 2 if ratio else np.nan, 2),
        "correlation with all": round(agreement, 2),
    }


def simulated(
    baseline: Baseline, cells: Sequence[Cell], trials: int, at: int | None = None
) -> dict[str, float]:
    """Return core-hours and share of decided trials, in simulations with each core teacher as the new one.

    True differences from Random are those observed in these cells.
    """
    frames = baseline.frames()
    runs = released_runs(frames, at)
    design = make_design("lab:New", baseline, frames, cells=[cell.name for cell in cells], steps=at)
    weights, setting = design.estimand().weights, setting_of(design, runs)
    areas = [in_cell(runs, key).groupby("teacher")["mastered_area"].mean() for key in design.keys]
    teachers = [name for name in common_teachers(cells) if name != "random"]
    effects = {name: float(weights @ [area[name] - area["random"] for area in areas]) for name in teachers}
    outcomes = [simulate(setting, effects[name], trials) for name in teachers]
    decided = [
        np.isin(outcome.verdicts[0], [TrialVerdict.BETTER, TrialVerdict.WORSE]) for outcome in outcomes
    ]
    hours = sum(cell.hours for cell in cells)
    return {
        "core-hours of a trial": round(hours * float(np.mean([outcome.seeds for outcome in outcomes])), 2),
        "decided against Random, %": round(100 * float(np.mean(decided)), 1),
    }


def measure(baseline: Baseline, trials: int, at: int | None = None) -> pd.DataFrame:
    """Return the table: single cells, and the cheapest set of each size.

    Args:
        baseline: release.
        trials: number of simulated trials of each teacher.
        at: environment steps of each run of a trial; None for those of the release.
    """
    cells = released(baseline, at)
    rows = [row(cell.name, [cell], cells) for cell in cells]
    if at is None and baseline.manifest.name == RELEASE:
        rows += [row(cell.name, [cell]) for cell in parkour()]
    for size in range(1, len(cells) + 1):
        chosen = min(
            itertools.combinations(cells, size),
            key=lambda some: np.nan_to_num(row("", some)["core-hours to tell two apart"], nan=np.inf),
        )
        name = "; ".join(cell.name for cell in chosen)
        rows.append(row(name, chosen, cells) | simulated(baseline, chosen, trials, at))
    return pd.DataFrame(rows)


def recommended(table: pd.DataFrame) -> list[str]:
    """Return the cells of the cheapest trial that decides about as often as one on all cells.

    Those are all cells if no smaller set saves `SAVED`, or if each loses more than `LOST`.
    """
    sets = table.dropna(subset=["core-hours of a trial"])
    hours, decided = sets["core-hours of a trial"], sets["decided against Random, %"]
    usable = (hours <= (1 - SAVED) * hours.iloc[-1]) & (decided >= decided.iloc[-1] - LOST)
    usable.iloc[-1] = True
    return str(sets.loc[hours[usable].idxmin(), "cells"]).split("; ")


def main() -> None:
    """Print the table as CSV."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument(
        "--trials", type=int, default=TRIALS, help="simulated trials of a teacher (%(default)s)"
    )
    parser.add_argument("--release", default=RELEASE, help="release of the trials (%(default)s)")
    parser.add_argument("--steps", type=int, help="environment steps of each run (those of the release)")
    options = parser.parse_args()
    table = measure(find_baseline(options.release), options.trials, options.steps)
    table.to_csv(sys.stdout, index=False)


if __name__ == "__main__":
    main()

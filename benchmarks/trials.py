"""Simulated trials with residuals of a release: error rates, seeds to the verdict, bias of estimates.

python benchmarks/trials.py > benchmarks/measured/trials.csv
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np
import pandas as pd

from analysis.baselines import find_baseline
from analysis.measures.tested import FINAL
from analysis.trials.boundaries import median_unbiased
from analysis.trials.design import make_design, released_runs, setting_of
from analysis.trials.rules import Setting, SimulatedOutcomes, TrialVerdict, simulate

TRIALS = 4_000

SEED = 2026
"""Seed of the trials, different from `SIMULATION_SEED`."""

CELLS = (("original", "diverse_students/spider"), ("original",), ("rugged_difficulty",))
"""Sets of cells beside all cells and those of the release's trials."""


def row(setting: Setting, end: Setting, factor: float, trials: int) -> dict[str, object]:
    """Return the results of trials in which the new teacher is `factor` margins better than all others.

    Wrong verdicts are also counted without least variances, and by the setting `end` with its own margin.
    """
    true = factor * setting.rules[0].margin
    found = simulate(setting, true, trials, SEED)
    own = replace(setting, estimand=replace(setting.estimand, least=np.zeros_like(setting.runs)))
    last = simulate(end, factor * end.rules[0].margin, trials, SEED)
    shares: dict[str, object] = {}
    for name, verdicts in zip(("random", "best"), found.verdicts, strict=True):
        shares |= {f"{name}_{verdict.value}": (verdicts == verdict).mean() for verdict in TrialVerdict}
    rule = setting.rules[0]
    return {
        "cells": len(setting.runs),
        "margin": rule.margin,
        "spent": rule.error * len(setting.rules),
        "true": true,
        "seeds": found.seeds.mean(),
        "wrong": found.wrong.mean(),
        "wrong_own_variances": simulate(own, true, trials, SEED).wrong.mean(),
        "wrong_in_the_end": last.wrong.mean(),
        **shares,
        "naive_bias": found.estimates[0].mean() - true,
        "median_bias": np.median(unbiased(setting, found)) - true,
    }


def unbiased(setting: Setting, found: SimulatedOutcomes) -> list[float]:
    """Return the median-unbiased estimates of the difference from Random, by trial."""
    rule, estimates = setting.rules[0], []
    planned = [1 / (1 / seeds + 1 / setting.runs[0]) for seeds in rule.looks]
    for look, value, error in zip(found.looks[0], found.estimates[0], found.errors[0], strict=True):
        information = [each / planned[look] / error**2 for each in planned[: look + 1]]
        bounds = rule.lower if value > 0 else rule.upper
        estimates.append(median_unbiased(value / error, bounds[:look], information))
    return estimates


def main() -> None:
    """Print a row per set of cells and true difference."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--trials", type=int, default=TRIALS, help="simulated trials of a row (%(default)s)")
    parser.add_argument("--release", default="lite-2", help="release whose runs are taken (%(default)s)")
    given = parser.parse_args()
    baseline = find_baseline(given.release)
    frames = baseline.frames()
    released = released_runs(frames)
    rows = []
    for names in dict.fromkeys(((), baseline.manifest.trial_cells, *CELLS)):
        design = make_design("trial", baseline, frames, cells=names)
        settings = setting_of(design, released), setting_of(design, released, FINAL)
        rows += [
            {"names": ", ".join(names) or "all"} | row(*settings, factor, given.trials)
            for factor in (-1, 0, 1, 2)
        ]
    pd.DataFrame(rows).to_csv(sys.stdout, index=False, float_format="%.4f")


if __name__ == "__main__":
    main()

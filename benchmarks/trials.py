"""Trials simulated with the residuals of a release: errors, seeds to the verdict, and the bias of estimates.

python benchmarks/trials.py > benchmarks/measured/trials.csv
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
import pandas as pd

from analysis.baselines import find_baseline
from analysis.trials.boundaries import median_unbiased
from analysis.trials.design import make_design, released_runs, setting_of
from analysis.trials.rules import Outcomes, Setting, Verdict, simulate

TRIALS = 4_000

SEED = 2026
"""Of the trials; another one than that of the calibration of designs."""

CELLS = ((), ("original", "diverse_students/spider"), ("original",), ("rugged_difficulty",))


def row(setting: Setting, true: float, trials: int) -> dict[str, object]:
    """Return what `trials` trials of a teacher come to that is `true` points better than all others."""
    found = simulate(setting, true, trials, SEED)
    shares: dict[str, object] = {}
    for name, verdicts in zip(("random", "best"), found.verdicts, strict=True):
        shares |= {f"{name}_{verdict.value}": (verdicts == verdict).mean() for verdict in Verdict}
    rule = setting.rules[0]
    return {
        "cells": len(setting.slopes),
        "margin": rule.margin,
        "spent": rule.error * len(setting.rules),
        "true": true,
        "seeds": found.seeds.mean(),
        "wrong": found.wrong.mean(),
        **shares,
        "naive_bias": found.estimates[0].mean() - true,
        "median_bias": np.median(unbiased(setting, found)) - true,
    }


def unbiased(setting: Setting, found: Outcomes) -> list[float]:
    """Return the median-unbiased estimates of the difference to Random, of each trial."""
    rule, estimates = setting.rules[0], []
    planned = [1 / (1 / seeds + 1 / setting.runs[0]) for seeds in rule.looks]
    for look, value, error in zip(found.looks[0], found.estimates[0], found.errors[0], strict=True):
        information = [each / planned[look] / error**2 for each in planned[: look + 1]]
        bounds = rule.lower if value > 0 else rule.upper
        estimates.append(median_unbiased(value / error, bounds[:look], information))
    return estimates


def main() -> None:
    """Print a row for each choice of cells and each true difference."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--trials", type=int, default=TRIALS, help="simulated trials of a row (%(default)s)")
    parser.add_argument("--release", default="lite-2", help="release whose runs are taken (%(default)s)")
    given = parser.parse_args()
    baseline = find_baseline(given.release)
    frames = baseline.frames()
    released = released_runs(frames)
    rows = []
    for wanted in CELLS:
        design = make_design("trial", baseline, frames, wanted=wanted)
        setting = setting_of(design, released)
        rows += [
            {"names": ", ".join(wanted) or "all"} | row(setting, factor * design.margin, given.trials)
            for factor in (-1, 0, 1, 2)
        ]
    pd.DataFrame(rows).to_csv(sys.stdout, index=False, float_format="%.4f")


if __name__ == "__main__":
    main()

"""Simulated trials, thousands at once, by the same rules, with residuals of released runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.trials.rules import (
    COMPARISONS,
    FUTILE,
    Floats,
    Moments,
    Rule,
    Verdict,
    difference,
)

SEED = 41
"""Seed of simulated trials: a design is the same whenever it is made."""


@dataclass(frozen=True)
class Outcomes:
    """Ends of simulated trials; the first of two comparisons is with Random, the second with the best.

    Attributes:
        verdicts: `Verdict` of each comparison (2, trials).
        seeds: seeds of every cell that were run (trials,).
        estimates: difference at the look that decided, or the last one (2, trials), in points.
        errors: its standard errors at that look (2, trials).
        looks: number of that look (2, trials), from 0 on.
        wrong: True where either verdict is wrong (trials,).
    """

    verdicts: NDArray[np.str_]
    seeds: NDArray[np.int64]
    estimates: Floats
    errors: Floats
    looks: NDArray[np.int64]
    wrong: NDArray[np.bool_]


@dataclass(frozen=True)
class Setting:
    """A design as simulated trials see it.

    Attributes:
        rules: rules of the comparisons with Random and with the best.
        slopes: points per radian in each cell (cells,).
        residuals: residuals of runs in each cell (n,), rad, of which each run draws one.
        runs: number of runs of each reference in each cell (cells,).
    """

    rules: tuple[Rule, ...]
    slopes: Floats
    residuals: tuple[Floats, ...]
    runs: Floats


def simulate(setting: Setting, true: float, trials: int, seed: int = SEED) -> Outcomes:
    """Return the ends of trials where released teachers are alike and the new one differs by `true` points.

    That is the least favourable case of the choice of the best: any candidate may seem so.

    Args:
        setting: simulated setting.
        true: true difference of the new teacher to any other, in points.
        trials: number of trials.
        seed: seed of the random draws.
    """
    rng = np.random.default_rng(seed)
    slopes, looks, margin = setting.slopes, setting.rules[0].looks, setting.rules[0].margin
    new = np.stack([rng.choice(values, (trials, looks[-1])) for values in setting.residuals], axis=1)
    new += (true / slopes)[:, None]
    references = _references(setting, trials, rng)
    shape = (COMPARISONS, trials)
    verdicts = np.full(shape, Verdict.OPEN, dtype="<U6")
    estimates, errors, at = np.zeros(shape), np.zeros(shape), np.zeros(shape, np.int64)
    seeds, going = np.full(trials, looks[-1]), np.ones(trials, bool)
    for look, count in enumerate(looks):
        teacher = Moments.of(new[:, :, :count])
        hopeless = np.ones(trials, bool)
        for place, (rule, reference) in enumerate(zip(setting.rules, references, strict=True)):
            found = difference(teacher, reference, slopes)
            live = going & (verdicts[place] == Verdict.OPEN)
            verdicts[place][live] = rule.verdicts(found, look)[live]
            estimates[place][live], errors[place][live] = found.value[live], found.error[live]
            at[place][live] = look
            power = rule.power(teacher, reference, slopes)
            hopeless &= (verdicts[place] != Verdict.OPEN) | (power < FUTILE)
        stops = going & hopeless
        seeds[stops] = count
        going &= ~stops
    false = {Verdict.BETTER: true <= 0, Verdict.WORSE: true >= 0, Verdict.ALIKE: abs(true) >= margin}
    wrong = np.isin(verdicts, [verdict.value for verdict, applies in false.items() if applies])
    return Outcomes(verdicts, seeds, estimates, errors, at, np.any(wrong, axis=0))


def _references(setting: Setting, trials: int, rng: np.random.Generator) -> tuple[Moments, Moments]:
    """Return the moments of Random and of the candidate with the highest mean in each trial."""
    shape = trials, setting.rules[-1].candidates + 1
    cells = zip(setting.residuals, setting.runs, strict=True)
    drawn = [rng.choice(values, (*shape, int(runs))) for values, runs in cells]
    means = np.stack([values.mean(axis=2) for values in drawn], axis=2)
    variances = np.stack([values.var(axis=2, ddof=1) for values in drawn], axis=2)
    best = 1 + (means[:, 1:] * setting.slopes).sum(axis=2).argmax(axis=1)
    every = np.arange(trials)
    return (
        Moments(means[:, 0], variances[:, 0], setting.runs),
        Moments(means[every, best], variances[every, best], setting.runs),
    )

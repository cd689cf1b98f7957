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
    planned_fractions,
)

SEED = 41
"""Seed of simulated trials: a design is the same whenever it is made."""


@dataclass(frozen=True)
class Cell:
    """A cell of simulated trials.

    Attributes:
        slope: points per radian.
        residuals: residuals of runs (n,), rad, of which each run draws one.
        runs: number of runs of each reference.
    """

    slope: float
    residuals: Floats
    runs: int


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
        cells: cells of the trial.
        looks: seeds of every cell at each look.
        margin: difference in points that does not matter.
        candidates: teachers that the best is chosen among.
        error: error that is spent by both comparisons together.
    """

    cells: tuple[Cell, ...]
    looks: tuple[int, ...]
    margin: float
    candidates: int
    error: float

    @property
    def slopes(self) -> Floats:
        """Points per radian in each cell (cells,)."""
        return np.array([cell.slope for cell in self.cells])

    @property
    def rules(self) -> list[Rule]:
        """Rules of the comparisons with Random and with the best."""
        runs = np.array([float(cell.runs) for cell in self.cells])
        fractions = planned_fractions(self.looks, self.slopes, runs)
        error = self.error / COMPARISONS
        return [Rule(self.looks, fractions, self.margin, chosen, error) for chosen in (1, self.candidates)]


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
    slopes, looks = setting.slopes, setting.looks
    new = np.stack([rng.choice(cell.residuals, (trials, looks[-1])) for cell in setting.cells], axis=1)
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
            estimates[place][live], errors[place][live], at[place][live] = (
                found.value[live],
                found.error[live],
                look,
            )
            power = rule.power(teacher, reference, slopes)
            hopeless &= (verdicts[place] != Verdict.OPEN) | (power < FUTILE)
        stops = going & hopeless
        seeds[stops] = count
        going &= ~stops
    return Outcomes(
        verdicts, seeds, estimates, errors, at, np.any(wrong(verdicts, true, setting.margin), axis=0)
    )


def wrong(verdicts: NDArray[np.str_], true: float, margin: float) -> NDArray[np.bool_]:
    """Return the verdicts that are wrong where the true difference is `true` points."""
    refuted = {
        Verdict.BETTER: true <= 0,
        Verdict.WORSE: true >= 0,
        Verdict.ALIKE: abs(true) >= margin,
    }
    return np.isin(verdicts, [verdict.value for verdict, false in refuted.items() if false])


def _references(setting: Setting, trials: int, rng: np.random.Generator) -> tuple[Moments, Moments]:
    """Return the moments of Random and of the candidate with the highest mean in each trial."""
    runs = np.array([float(cell.runs) for cell in setting.cells])
    shape = trials, setting.candidates + 1
    drawn = [rng.choice(cell.residuals, (*shape, cell.runs)) for cell in setting.cells]
    means = np.stack([values.mean(axis=2) for values in drawn], axis=2)
    variances = np.stack([values.var(axis=2, ddof=1) for values in drawn], axis=2)
    best = 1 + (means[:, 1:] * setting.slopes).sum(axis=2).argmax(axis=1)
    every = np.arange(trials)
    return (
        Moments(means[:, 0], variances[:, 0], runs),
        Moments(means[every, best], variances[every, best], runs),
    )

"""The rules of a trial: repeated confidence intervals at its looks, verdicts by them, and when it is futile.

Every function takes arrays: one trial, or thousands of simulated ones, by the same rules.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import special

from analysis.statistics.samples import negligible
from analysis.trials.boundaries import boundaries

LOOKS = (3, 5, 10, 20)
"""Seeds of every cell after which a trial is looked at."""

ERROR = 0.05
"""Probability of a wrong verdict in either comparison, at any look."""

COMPARISONS = 2
"""With Random and with the best teacher: each has an equal part of the error (Bonferroni)."""

FUTILE = 0.3
"""Conditional power under which a comparison is given up."""

Floats = NDArray[np.float64]


class Verdict(StrEnum):
    """Verdict of a comparison at a look.

    Attributes:
        BETTER: the interval is over 0.
        WORSE: it is under 0.
        ALIKE: it is within the margin.
        OPEN: none of these; more seeds may tell.
    """

    BETTER = "better"
    WORSE = "worse"
    ALIKE = "alike"
    OPEN = "open"


@dataclass(frozen=True)
class Moments:
    """Means of samples of runs in cells, on the arcsine scale.

    Attributes:
        mean: means (..., cells), rad.
        variance: variances of one run (..., cells), rad²; 0 in place of rounding errors of the means.
        runs: number of runs of each (cells,).
    """

    mean: Floats
    variance: Floats
    runs: Floats

    def __post_init__(self) -> None:
        spread = ~negligible(np.sqrt(self.variance), self.mean)
        object.__setattr__(self, "variance", np.where(spread, self.variance, 0.0))

    @classmethod
    def of(cls, values: Floats) -> "Moments":
        """Return the moments of samples (..., cells, runs)."""
        runs = np.full(values.shape[-2], float(values.shape[-1]))
        return cls(values.mean(axis=-1), values.var(axis=-1, ddof=1), runs)


@dataclass(frozen=True, eq=False)
class Estimand:
    """Quantity that a trial estimates: the weighted mean of the cells' differences, in points.

    Attributes:
        weights: weight of each cell (cells,), of `statistics.stratum_weights`, adding up to 1.
        slopes: points per unit of the scale on which moments are (cells,).
        least: least variance of a run that counts in each cell (cells,), of `statistics.least_variance`, on
            the same scale.
    """

    weights: Floats
    slopes: Floats
    least: Floats

    @property
    def factors(self) -> Floats:
        """Points of the estimand per unit of the scale in each cell (cells,)."""
        return self.weights * self.slopes

    def variance(self, sample: Moments) -> Floats:
        """Return the variances of one run that count in standard errors (..., cells)."""
        return np.maximum(sample.variance, self.least)


@dataclass(frozen=True)
class Difference:
    """Differences of a teacher to a reference over all cells, in points of the measure.

    Attributes:
        value: weighted mean over cells (...).
        error: its standard error (...).
        freedom: degrees of freedom after Welch and Satterthwaite (...); NaN where no sample has a spread.
    """

    value: Floats
    error: Floats
    freedom: Floats


def difference(teacher: Moments, reference: Moments, estimand: Estimand) -> Difference:
    """Return the difference over cells, tested as by `statistics.stratified` with least variances.

    These widen the standard error and leave the degrees of freedom as they are.
    """
    squares = estimand.factors**2
    sides = [(side, squares / side.runs) for side in (teacher, reference)]
    own = [(factors * side.variance, side.runs - 1) for side, factors in sides]
    with np.errstate(invalid="ignore", divide="ignore"):  # no spread in any sample: no interval
        freedom = sum(part.sum(axis=-1) for part, _ in own) ** 2 / sum(
            (part**2 / count).sum(axis=-1) for part, count in own
        )
    variance = sum((factors * estimand.variance(side)).sum(axis=-1) for side, factors in sides)
    value = (estimand.factors * (teacher.mean - reference.mean)).sum(axis=-1)
    return Difference(value, np.sqrt(variance), freedom)


@dataclass(frozen=True)
class Rule:
    """The rule of one comparison.

    Attributes:
        looks: seeds of every cell at each look.
        fractions: information of each look over that of the last, as planned.
        margin: largest difference in points that does not matter.
        candidates: number of teachers of which the reference was the best; 1 if it was not chosen.
        error: probability of a wrong verdict at any look.
    """

    looks: tuple[int, ...]
    fractions: tuple[float, ...]
    margin: float
    candidates: int = 1
    error: float = ERROR / COMPARISONS

    @cached_property
    def lower(self) -> tuple[float, ...]:
        """Standard errors under the difference at which the interval of each look begins, if normal."""
        return self._bounds(self.error / 2)

    @cached_property
    def upper(self) -> tuple[float, ...]:
        """Standard errors over the difference at which it ends: further for one chosen as the best.

        The best of several is overestimated, so that the difference to it is underestimated, never
        overestimated: only end that needs Šidák's correction.
        """
        return self._bounds(1 - (1 - self.error / 2) ** (1 / self.candidates))

    def _bounds(self, error: float) -> tuple[float, ...]:
        """Return boundaries that hold whatever the ratio of variances of teacher and reference is.

        Error is spent by the planned information. Statistics of looks are least correlated, and cross most
        often, where all variance is the new teacher's: this correlation is used (Slepian, 1962).
        """
        return boundaries(self.fractions, error, tuple(map(float, self.looks)))

    def interval(self, found: Difference, look: int) -> tuple[Floats, Floats]:
        """Return both ends of the repeated confidence interval at look `look`, from 0 on.

        Student's t in the place of the normal distribution, at the same probability. All intervals of a
        trial hold the true difference at once with probability 1 - error.
        """
        return (
            found.value - self.reach(found, look, above=True),
            found.value + self.reach(found, look, above=False),
        )

    def reach(self, found: Difference, look: int, *, above: bool) -> Floats:
        """Return the least difference from 0, in points, for better at look `look`, or else for worse."""
        bounds = self.lower if above else self.upper
        with np.errstate(invalid="ignore"):  # no spread in any sample: nothing is far enough
            reach = quantile(found.freedom, bounds[look]) * found.error
            return np.asarray(np.where(found.freedom > 0, reach, math.inf), np.float64)

    def verdicts(self, found: Difference, look: int) -> NDArray[np.str_]:
        """Return the `Verdict` of each difference at look `look`."""
        low, high = self.interval(found, look)
        decided = (low > 0, high < 0, (low > -self.margin) & (high < self.margin))
        return np.select(decided, (Verdict.BETTER, Verdict.WORSE, Verdict.ALIKE), Verdict.OPEN)

    def power(
        self, teacher: Moments, reference: Moments, estimand: Estimand, last: int | None = None
    ) -> Floats:
        """Return the probability that a later look decides, as the seeds so far let expect.

        Conditional power at look `last`, by default the last one, averaged over the differences that the
        seeds so far leave open (predictive power; Spiegelhalter, Freedman and Blackburn, 1986).
        """
        last = len(self.looks) - 1 if last is None else last
        seeds = np.full_like(teacher.runs, self.looks[last])
        now = difference(teacher, reference, estimand)
        then = difference(Moments(teacher.mean, teacher.variance, seeds), reference, estimand)
        parts = estimand.factors**2 * estimand.variance(teacher) * (1 / teacher.runs - 1 / seeds)
        spread = np.sqrt(np.maximum(parts.sum(axis=-1), np.finfo(float).tiny))
        low, high = (self.reach(then, last, above=above) for above in (True, False))
        # It decides outside [-high, low], and between low - margin and margin - high.
        inside = np.minimum(self.margin - high, low), np.maximum(low - self.margin, -high)

        def chance(value: Floats) -> Floats:
            return np.asarray(special.ndtr((value - now.value) / spread), np.float64)

        undecided = chance(low) - chance(-high)
        alike = np.maximum(chance(inside[0]) - chance(inside[1]), 0.0)
        return np.asarray(1 - undecided + alike, np.float64)


def planned_fractions(looks: Sequence[int], factors: Floats, reference_runs: Floats) -> tuple[float, ...]:
    """Return the information of each look over that of the last, for equal variances in all samples.

    The reference's runs in each cell (cells,) are fixed: their part of the variance stays. `factors` are
    those of the `Estimand`.
    """
    variances = [float((factors**2 * (1 / seeds + 1 / reference_runs)).sum()) for seeds in looks]
    return tuple(variances[-1] / variance for variance in variances)


def quantile(freedom: Floats, bound: float) -> Floats:
    """Return Student's quantiles at the probability of a normal statistic under `bound`."""
    return np.asarray(-special.stdtrit(freedom, float(special.ndtr(-bound))), np.float64)


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
        estimand: estimand of both.
        residuals: residuals of the runs of each released teacher in each cell, Random first, the candidates
            for the best after it (cells, teachers, (n,)), on the scale of the moments.
        runs: number of runs of each reference in each cell (cells,).
    """

    rules: tuple[Rule, ...]
    estimand: Estimand
    residuals: tuple[tuple[Floats, ...], ...]
    runs: Floats


def simulate(setting: Setting, true: float, trials: int, seed: int = SEED) -> Outcomes:
    """Return the ends of trials where released teachers are alike and the new one differs by `true` points.

    That is the least favourable case of the choice of the best: any candidate may seem so. Runs of a released
    teacher have residuals of its own runs, so that variances differ between teachers as they do, and runs
    of the new one those of a teacher that each trial draws.

    Args:
        setting: simulated setting.
        true: true difference of the new teacher to any other, in points.
        trials: number of trials.
        seed: seed of the random draws.
    """
    rng = np.random.default_rng(seed)
    estimand, looks, margin = setting.estimand, setting.rules[0].looks, setting.rules[0].margin
    new = _new_runs(setting, trials, rng) + (true / estimand.slopes)[:, None]
    references = _references(setting, trials, rng)
    shape = (COMPARISONS, trials)
    verdicts = np.full(shape, Verdict.OPEN, dtype="<U6")
    estimates, errors, at = np.zeros(shape), np.zeros(shape), np.zeros(shape, np.int64)
    seeds, going = np.full(trials, looks[-1]), np.ones(trials, bool)
    for look, count in enumerate(looks):
        teacher = Moments.of(new[:, :, :count])
        hopeless = np.ones(trials, bool)
        for place, (rule, reference) in enumerate(zip(setting.rules, references, strict=True)):
            found = difference(teacher, reference, estimand)
            live = going & (verdicts[place] == Verdict.OPEN)
            verdicts[place][live] = rule.verdicts(found, look)[live]
            estimates[place][live], errors[place][live] = found.value[live], found.error[live]
            at[place][live] = look
            power = rule.power(teacher, reference, estimand)
            hopeless &= (verdicts[place] != Verdict.OPEN) | (power < FUTILE)
        stops = going & hopeless
        seeds[stops] = count
        going &= ~stops
    false = {Verdict.BETTER: true <= 0, Verdict.WORSE: true >= 0, Verdict.ALIKE: abs(true) >= margin}
    wrong = np.isin(verdicts, [verdict.value for verdict, applies in false.items() if applies])
    return Outcomes(verdicts, seeds, estimates, errors, at, np.any(wrong, axis=0))


def _new_runs(setting: Setting, trials: int, rng: np.random.Generator) -> Floats:
    """Return runs of a new teacher in each trial (trials, cells, seeds), around 0."""
    drawn = np.zeros((trials, len(setting.residuals), setting.rules[0].looks[-1]))
    likes = rng.integers(len(setting.residuals[0]), size=trials)
    for cell, teachers in enumerate(setting.residuals):
        for teacher, values in enumerate(teachers):
            mine = likes == teacher
            drawn[mine, cell] = rng.choice(values, (int(mine.sum()), drawn.shape[2]))
    return drawn


def _references(setting: Setting, trials: int, rng: np.random.Generator) -> tuple[Moments, Moments]:
    """Return the moments of Random and of the candidate with the highest mean in each trial."""
    shape = len(setting.residuals[0]), trials, len(setting.residuals)
    means, variances = np.zeros(shape), np.zeros(shape)
    for cell, (teachers, runs) in enumerate(zip(setting.residuals, setting.runs, strict=True)):
        for teacher, values in enumerate(teachers):
            own = rng.choice(values, (trials, int(runs)))
            means[teacher, :, cell], variances[teacher, :, cell] = own.mean(axis=1), own.var(axis=1, ddof=1)
    best = 1 + (means[1:] * setting.estimand.factors).sum(axis=2).argmax(axis=0)
    every = np.arange(trials)
    return (
        Moments(means[0], variances[0], setting.runs),
        Moments(means[best, every], variances[best, every], setting.runs),
    )

"""Decision rules of trials: repeated confidence intervals, verdicts and futility.

All functions are vectorised: they take one trial or thousands of simulated ones.
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

LOOKS = (3, 5, 10, 20)  # cumulative number of the new teacher's seeds per cell at each look
ERROR = 0.05  # probability of a wrong verdict, over both comparisons and all looks

COMPARISONS = 2
"""Number of comparisons, with Random and the best teacher, which share the error equally (Bonferroni)."""

FUTILE = 0.3  # predictive power below which a comparison is futile

Floats = NDArray[np.float64]


class TrialVerdict(StrEnum):
    """Verdict of a comparison at a look."""

    BETTER = "better"  # interval entirely above 0
    WORSE = "worse"  # interval entirely below 0
    ALIKE = "alike"  # interval entirely within ± the margin
    OPEN = "open"  # none of these


@dataclass(frozen=True)
class Moments:
    """Means and variances of a teacher's runs in each cell, on the scale of the test."""

    mean: Floats  # means (..., cells)
    variance: Floats  # sample variances (..., cells); 0 if they are mere rounding errors
    runs: Floats  # number of runs (cells,)

    def __post_init__(self) -> None:
        spread = ~negligible(np.sqrt(self.variance), self.mean)
        object.__setattr__(self, "variance", np.where(spread, self.variance, 0.0))

    @classmethod
    def of(cls, values: Floats) -> "Moments":
        """Return the moments of `values` (..., cells, runs)."""
        runs = np.full(values.shape[-2], float(values.shape[-1]))
        return cls(values.mean(axis=-1), values.var(axis=-1, ddof=1), runs)


@dataclass(frozen=True, eq=False)
class Estimand:
    """Estimand of a trial: the weighted mean of the cells' differences, in points."""

    weights: Floats  # weight of each cell (cells,), summing to 1
    slopes: Floats  # slope of each cell (cells,), in points per unit of the moments' scale
    least: Floats  # `statistics.least_variance` of each cell (cells,), on the moments' scale

    @property
    def factors(self) -> Floats:
        """Points of the estimand per unit of each cell's moments, as an array (cells,)."""
        return self.weights * self.slopes

    def variance(self, sample: Moments) -> Floats:
        """Return the variances (..., cells) that enter standard errors, with `least` as a lower bound."""
        return np.maximum(sample.variance, self.least)


@dataclass(frozen=True)
class DifferenceEstimate:
    """Estimate of the difference between a teacher and a reference over all cells, in points."""

    value: Floats  # weighted mean over cells (...)
    error: Floats  # standard error (...)
    freedom: Floats  # Welch-Satterthwaite degrees of freedom (...); NaN if all variances are 0


def difference(teacher: Moments, reference: Moments, estimand: Estimand) -> DifferenceEstimate:
    """Estimate the difference between two teachers over all cells, as in `statistics.stratified`.

    Least variances widen the standard error and leave the degrees of freedom as they are.
    """
    squares = estimand.factors**2
    groups = [(group, squares / group.runs) for group in (teacher, reference)]
    terms = [(factors * group.variance, group.runs - 1) for group, factors in groups]
    with np.errstate(invalid="ignore", divide="ignore"):  # 0/0 where all samples have zero variance
        freedom = sum(term.sum(axis=-1) for term, _ in terms) ** 2 / sum(
            (term**2 / count).sum(axis=-1) for term, count in terms
        )
    variance = sum((factors * estimand.variance(group)).sum(axis=-1) for group, factors in groups)
    value = (estimand.factors * (teacher.mean - reference.mean)).sum(axis=-1)
    return DifferenceEstimate(value, np.sqrt(variance), freedom)


@dataclass(frozen=True)
class DecisionRule:
    """Group-sequential decision rule of one comparison."""

    looks: tuple[int, ...]  # cumulative number of the new teacher's seeds per cell at each look
    fractions: tuple[float, ...]  # planned information at each look, as a share of the last look's
    margin: float  # equivalence margin, in points
    candidates: int = 1  # number of teachers the reference is the best of; 1 if it was fixed in advance
    error: float = ERROR / COMPARISONS  # probability of a wrong verdict over all looks

    @cached_property
    def lower(self) -> tuple[float, ...]:
        """Boundaries for the lower ends of intervals, on the scale of a standard normal statistic."""
        return self._bounds(self.error / 2)

    @cached_property
    def upper(self) -> tuple[float, ...]:
        """Boundaries for the upper ends of intervals, with Šidák's correction for choosing the best teacher.

        The best of several is overestimated and the difference to it underestimated, so only this end needs
        the correction.
        """
        return self._bounds(1 - (1 - self.error / 2) ** (1 / self.candidates))

    def _bounds(self, error: float) -> tuple[float, ...]:
        """Return boundaries that spend at most `error`, whatever the variances of teacher and reference.

        Crossing is most likely where statistics of looks correlate least (Slepian, 1962), which is where all
        variance is the new teacher's and information grows with its seeds.
        """
        return boundaries(self.fractions, error, tuple(map(float, self.looks)))

    def interval(self, estimate: DifferenceEstimate, look: int) -> tuple[Floats, Floats]:
        """Return both ends of the repeated confidence interval at a look.

        Student's quantiles replace the normal ones. With probability 1 - error all intervals of a trial hold
        the true difference.
        """
        return (
            estimate.value - self.reach(estimate, look, above=True),
            estimate.value + self.reach(estimate, look, above=False),
        )

    def reach(self, estimate: DifferenceEstimate, look: int, *, above: bool) -> Floats:
        """Return the smallest difference in points that counts as better (if `above`) or worse at a look."""
        bounds = self.lower if above else self.upper
        with np.errstate(invalid="ignore"):  # NaN where all samples have zero variance
            reach = quantile(estimate.freedom, bounds[look]) * estimate.error
            return np.asarray(np.where(estimate.freedom > 0, reach, math.inf), np.float64)

    def verdicts(self, estimate: DifferenceEstimate, look: int) -> NDArray[np.str_]:
        """Return the `TrialVerdict` of each difference at a look."""
        low, high = self.interval(estimate, look)
        decided = (low > 0, high < 0, (low > -self.margin) & (high < self.margin))
        return np.select(
            decided, (TrialVerdict.BETTER, TrialVerdict.WORSE, TrialVerdict.ALIKE), TrialVerdict.OPEN
        )

    def power(
        self, teacher: Moments, reference: Moments, estimand: Estimand, last: int | None = None
    ) -> Floats:
        """Return the predictive power at look `last`, by default the final look.

        Conditional power, averaged over the differences that the seeds so far leave open (Spiegelhalter,
        Freedman and Blackburn, 1986).
        """
        last = len(self.looks) - 1 if last is None else last
        seeds = np.full_like(teacher.runs, self.looks[last])
        now = difference(teacher, reference, estimand)
        then = difference(Moments(teacher.mean, teacher.variance, seeds), reference, estimand)
        parts = estimand.factors**2 * estimand.variance(teacher) * (1 / teacher.runs - 1 / seeds)
        spread = np.sqrt(np.maximum(parts.sum(axis=-1), np.finfo(float).tiny))
        low, high = (self.reach(then, last, above=above) for above in (True, False))
        # The verdict is open within [-high, low], except between low - margin and margin - high, where it is
        # "alike".
        inside = np.minimum(self.margin - high, low), np.maximum(low - self.margin, -high)

        def chance(value: Floats) -> Floats:
            return np.asarray(special.ndtr((value - now.value) / spread), np.float64)

        undecided = chance(low) - chance(-high)
        alike = np.maximum(chance(inside[0]) - chance(inside[1]), 0.0)
        return np.asarray(1 - undecided + alike, np.float64)


def planned_fractions(looks: Sequence[int], factors: Floats, reference_runs: Floats) -> tuple[float, ...]:
    """Return the information at each look as a share of the last look's, assuming equal variances.

    Args:
        looks: number of the new teacher's seeds per cell at each look.
        factors: factors of the `Estimand` (cells,).
        reference_runs: number of runs of the reference, fixed for all looks (cells,).
    """
    variances = [float((factors**2 * (1 / seeds + 1 / reference_runs)).sum()) for seeds in looks]
    return tuple(variances[-1] / variance for variance in variances)


def quantile(freedom: Floats, bound: float) -> Floats:
    """Return Student's t quantiles at the probability whose normal quantile is `bound`."""
    return np.asarray(-special.stdtrit(freedom, float(special.ndtr(-bound))), np.float64)


SIMULATION_SEED = 41  # seed of the simulated trials, fixed to make designs reproducible


@dataclass(frozen=True)
class SimulatedOutcomes:
    """Outcomes of simulated trials, each with two comparisons: with Random and with the best teacher."""

    verdicts: NDArray[np.str_]  # `TrialVerdict` of each comparison (2, trials)
    seeds: NDArray[np.int64]  # number of seeds per cell that the new teacher ran (trials,)
    estimates: Floats  # difference in points at the look of the verdict, or at the last look (2, trials)
    errors: Floats  # standard error of the estimate (2, trials)
    looks: NDArray[np.int64]  # index of the look at which the estimate was made (2, trials)
    wrong: NDArray[np.bool_]  # True where either verdict is wrong (trials,)


@dataclass(frozen=True)
class Setting:
    """Parameters of simulated trials."""

    rules: tuple[DecisionRule, ...]  # rules of the comparisons with Random and with the best teacher
    estimand: Estimand  # estimand of both comparisons
    residuals: tuple[tuple[Floats, ...], ...]  # residuals (n,) by cell and teacher, Random first
    runs: Floats  # number of runs of each reference in each cell (cells,)


def simulate(setting: Setting, true: float, trials: int, seed: int = SIMULATION_SEED) -> SimulatedOutcomes:
    """Simulate trials in which released teachers have equal means and the new one differs by `true` points.

    Equal means are the least favourable case for the choice of the best. Runs of each released teacher are
    bootstrapped from its own residuals, and runs of the new one from those of a random teacher per trial.

    Args:
        setting: parameters of the simulation.
        true: true difference of the new teacher to all others, in points.
        trials: number of trials.
        seed: seed of the random draws.
    """
    rng = np.random.default_rng(seed)
    estimand, looks, margin = setting.estimand, setting.rules[0].looks, setting.rules[0].margin
    new = _new_runs(setting, trials, rng) + (true / estimand.slopes)[:, None]
    references = _references(setting, trials, rng)
    shape = (COMPARISONS, trials)
    verdicts = np.full(shape, TrialVerdict.OPEN, dtype="<U6")
    estimates, errors, decided_at = np.zeros(shape), np.zeros(shape), np.zeros(shape, np.int64)
    seeds, going = np.full(trials, looks[-1]), np.ones(trials, bool)
    for look, count in enumerate(looks):
        teacher = Moments.of(new[:, :, :count])
        hopeless = np.ones(trials, bool)
        for index, (rule, reference) in enumerate(zip(setting.rules, references, strict=True)):
            estimate = difference(teacher, reference, estimand)
            live = going & (verdicts[index] == TrialVerdict.OPEN)
            verdicts[index][live] = rule.verdicts(estimate, look)[live]
            estimates[index][live], errors[index][live] = estimate.value[live], estimate.error[live]
            decided_at[index][live] = look
            power = rule.power(teacher, reference, estimand)
            hopeless &= (verdicts[index] != TrialVerdict.OPEN) | (power < FUTILE)
        stops = going & hopeless
        seeds[stops] = count
        going &= ~stops
    false = {
        TrialVerdict.BETTER: true <= 0,
        TrialVerdict.WORSE: true >= 0,
        TrialVerdict.ALIKE: abs(true) >= margin,
    }
    wrong = np.isin(verdicts, [verdict.value for verdict, applies in false.items() if applies])
    return SimulatedOutcomes(verdicts, seeds, estimates, errors, decided_at, np.any(wrong, axis=0))


def _new_runs(setting: Setting, trials: int, rng: np.random.Generator) -> Floats:
    """Return simulated runs (trials, cells, seeds) of a new teacher with mean 0."""
    drawn = np.zeros((trials, len(setting.residuals), setting.rules[0].looks[-1]))
    likes = rng.integers(len(setting.residuals[0]), size=trials)
    for cell, teachers in enumerate(setting.residuals):
        for teacher, values in enumerate(teachers):
            chosen = likes == teacher
            drawn[chosen, cell] = rng.choice(values, (int(chosen.sum()), drawn.shape[2]))
    return drawn


def _references(setting: Setting, trials: int, rng: np.random.Generator) -> tuple[Moments, Moments]:
    """Return the simulated moments of Random and of the best other teacher in each trial."""
    shape = len(setting.residuals[0]), trials, len(setting.residuals)
    means, variances = np.zeros(shape), np.zeros(shape)
    for cell, (teachers, runs) in enumerate(zip(setting.residuals, setting.runs, strict=True)):
        for teacher, values in enumerate(teachers):
            drawn = rng.choice(values, (trials, int(runs)))
            means[teacher, :, cell] = drawn.mean(axis=1)
            variances[teacher, :, cell] = drawn.var(axis=1, ddof=1)
    best = 1 + (means[1:] * setting.estimand.factors).sum(axis=2).argmax(axis=0), np.arange(trials)
    return (
        Moments(means[0], variances[0], setting.runs),
        Moments(means[best], variances[best], setting.runs),
    )

"""Agreement of the ranking of teachers after a small budget with the rankings after larger ones."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from analysis.data.columns import CHALLENGE, STRATA
from analysis.data.frames import Frames
from analysis.formatting import number, steps_text
from analysis.measures.run_measures import evaluations_at
from analysis.measures.tested import FINAL, HEADLINE
from analysis.statistics import stratum_weights
from analysis.statistics.samples import TAIL, Estimate

CORRELATION_DRAWS = 20_000
"""Number of random draws behind the interval of a correlation."""

LEAST_FREEDOM = 4
"""Minimum degrees of freedom of both covariances; with fewer, draws have no second moments."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class EffectCorrelation(Estimate):
    """Correlation between true effects of teachers on two measures, with its 95 % interval.

    Attributes:
        observed: Pearson's correlation of the observed means, less the mean of their space.
        left_out: share of draws excluded from the interval for lack of a positive variance of true effects.
    """

    observed: float = math.nan
    left_out: float = math.nan


def effect_correlation(spaces: Sequence[Mapping[Any, ArrayLike]]) -> EffectCorrelation:
    """Return the correlation between the true effects of teachers on two measures.

    The correlation of observed means is biased: upwards since both measures of a run share its luck, and
    downwards since means of few seeds are noisy. Here the covariance between seeds is subtracted.

    In each of C spaces teachers have n seeds; an effect is a teacher's mean less that of its space. With B,
    the 2 x 2 matrix of mean squares and products between teachers (f degrees of freedom), and W, that between
    seeds of a cell (g), the covariance of true effects is (B - W) / n. The estimate is its correlation,
    clipped to [-1, 1], or NaN without a positive variance.

    The interval is a generalised one for normal effects and seeds: B and W are replaced by f B^½ Q^-1 B^½ and
    g W^½ R^-1 W^½, Q and R Wishart-distributed with f and g degrees of freedom; the interval has the middle
    95 % of the correlations of these. Its coverage is simulated in ``benchmarks/agreement_coverage.py``.

    Args:
        spaces: values (n, 2), a row per seed and a column per measure, by teacher; one mapping per space.
            For unequal n their harmonic mean is used.
    """
    samples = [[np.asarray(values, float) for values in space.values()] for space in spaces]
    cells = [values for space in samples for values in space]
    runs = sum(map(len, cells))
    freedom, noise_freedom = len(cells) - len(samples), runs - len(cells)
    if min(map(len, samples), default=0) < 2 or min(freedom, noise_freedom) < LEAST_FREEDOM:
        reason = f"needs {LEAST_FREEDOM} degrees of freedom"
        return EffectCorrelation(math.nan, math.nan, math.nan, runs, reason)
    n = len(cells) / sum(1 / len(values) for values in cells)
    means = [np.array([values.mean(axis=0) for values in space]) for space in samples]
    effects = np.concatenate([matrix - matrix.mean(axis=0) for matrix in means])
    residuals = np.concatenate([values - values.mean(axis=0) for values in cells])
    between, within = n * effects.T @ effects / freedom, residuals.T @ residuals / noise_freedom
    value, observed = (float(_correlations(matrix[None])[0]) for matrix in (between - within, between))
    rng = np.random.default_rng(0)
    drawn = _correlations(_drawn(between, freedom, rng) - _drawn(within, noise_freedom, rng))
    usable = drawn[~np.isnan(drawn)]
    left_out = 1 - len(usable) / CORRELATION_DRAWS
    if math.isnan(value) or left_out > 0.5:
        reason = "teachers differ by no more than chance"
        return EffectCorrelation(value, math.nan, math.nan, runs, reason, observed, left_out)
    low, high = np.quantile(usable, (1 - TAIL, TAIL))
    return EffectCorrelation(value, float(low), float(high), runs, "", observed, left_out)


def _drawn(covariance: Floats, freedom: int, rng: np.random.Generator) -> Floats:
    """Draw true covariance matrices (n, 2, 2), given their estimate (2, 2).

    Wishart matrices are L L' with Bartlett's lower triangular L.
    """
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.clip(values, 0.0, None))) @ vectors.T
    first, second = (np.sqrt(rng.chisquare(freedom - column, CORRELATION_DRAWS)) for column in (0, 1))
    inverse = np.zeros((CORRELATION_DRAWS, 2, 2))
    inverse[:, 0, 0], inverse[:, 1, 1] = 1 / first, 1 / second
    inverse[:, 1, 0] = -rng.standard_normal(CORRELATION_DRAWS) / (first * second)
    half = root @ inverse.transpose(0, 2, 1)
    return np.asarray(freedom * half @ half.transpose(0, 2, 1))


def _correlations(covariances: Floats) -> Floats:
    """Return the correlation of each covariance matrix (m, 2, 2), clipped; NaN without positive variances."""
    first, second, both = covariances[:, 0, 0], covariances[:, 1, 1], covariances[:, 0, 1]
    positive = (first > 0) & (second > 0)
    product = np.where(positive, first * second, 1.0)
    return np.where(positive, np.clip(both / np.sqrt(product), -1.0, 1.0), np.nan)


BUDGETS: Final = (2_000_000, 5_000_000, 10_000_000, 20_000_000)
"""Budgets that are compared, in steps, the early one first."""


@dataclass(frozen=True)
class BudgetAgreement:
    """Agreement of teachers' results at the early budget (`HEADLINE`) with a measure at a later one.

    Attributes:
        measure: `HEADLINE` or `FINAL`.
        budget: later budget, in steps.
        correlation: correlation of the true effects of teachers, with its interval.
        tau: Kendall's rank correlation of the observed means.
        pairs: number of pairs of teachers.
        reversed_pairs: number of pairs whose observed order changes.
    """

    measure: str
    budget: int
    correlation: EffectCorrelation
    tau: float
    pairs: int
    reversed_pairs: int

    def __str__(self) -> str:
        estimate = self.correlation
        ends = f"[{number(estimate.low, 2)}, {number(estimate.high, 2)}]"
        return f"{number(estimate.value, 2)} {f'({estimate.reason})' if estimate.reason else ends}"


@dataclass(frozen=True, eq=False)
class BudgetComparison:
    """Results of a leaderboard's teachers at several budgets.

    Attributes:
        means: mean of a measure, %, over challenges of equal weight: a row per teacher, the best in the end
            first, and columns (measure, budget).
        agreements: agreements with the early budget, by measure and budget.
    """

    means: pd.DataFrame
    agreements: tuple[BudgetAgreement, ...]

    @property
    def budgets(self) -> list[int]:
        """Budgets, in steps."""
        return sorted(self.means.columns.get_level_values("budget").unique())

    def row(self, budget: int) -> list[str]:
        """Return a later budget's table row: correlation and reversed pairs, for `FINAL` and `HEADLINE`."""
        by_measure = {
            agreement.measure: agreement for agreement in self.agreements if agreement.budget == budget
        }
        later = [by_measure[FINAL], by_measure[HEADLINE]]
        pairs = [[str(agreement), f"{agreement.reversed_pairs} of {agreement.pairs}"] for agreement in later]
        return [steps_text(budget), *itertools.chain(*pairs)]

    def sentence(self) -> str:
        """Return a sentence about the agreement of the early budget with the last one."""
        last, early = self.agreements[-1], steps_text(self.budgets[0])
        later, pairs = steps_text(last.budget), f"{last.reversed_pairs} of {last.pairs} pairs change places"
        if last.correlation.reason:
            return (
                f"Between the order of teachers over training after {early} steps and that in the end after "
                f"{later}, {pairs}."
            )
        return (
            f"The order of teachers over training after {early} steps agrees with that in the end after "
            f"{later} with a correlation of true effects of {last}; {pairs}."
        )


def compare_budgets(frames: Frames, runs: pd.DataFrame) -> BudgetComparison | None:
    """Compare a leaderboard's teachers at the `BUDGETS` that all its runs reach.

    The result is None for fewer than two such budgets or fewer than three teachers.

    Args:
        frames: results with these runs.
        runs: rows from `pooling.pool_runs` for one leaderboard.
    """
    budgets = [budget for budget in BUDGETS if budget <= runs["steps"].min()]
    if len(budgets) < 2 or runs["teacher"].nunique() < 3:
        return None
    measured = evaluations_at(frames, budgets)[["run_id", "step", HEADLINE, FINAL]]
    table = by_run(runs[["run_id", "teacher", *STRATA]].merge(measured, on="run_id"))
    strata = table.groupby([*STRATA, "teacher"]).mean().unstack("teacher")
    weights = stratum_weights(list(strata.index.to_frame()[CHALLENGE].itertuples(index=False, name=None)))
    shares = np.array(weights) / sum(weights)
    overall = pd.Series(shares @ strata.to_numpy(), strata.columns).unstack(["measure", "budget"])
    order = overall[FINAL, budgets[-1]].sort_values(ascending=False, kind="stable").index
    return BudgetComparison(overall.loc[order], tuple(agreements(table, overall)))


def by_run(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the results of runs measured at all budgets, indexed by teacher, `STRATA` and run_id.

    Args:
        rows: table with those columns, step (a budget), `HEADLINE` and `FINAL`.

    Returns:
        A column per measure and budget.
    """
    table = rows.pivot_table(index=["teacher", *STRATA, "run_id"], columns="step", values=[HEADLINE, FINAL])
    return table.dropna().rename_axis(columns=["measure", "budget"])


def agreements(table: pd.DataFrame, means: pd.DataFrame) -> Iterator[BudgetAgreement]:
    """Yield the agreements of the earliest budget with all later ones, for `HEADLINE` and for `FINAL`.

    Args:
        table: result of `by_run`.
        means: means over strata, a row per teacher; columns as in `table`.
    """
    columns: list[Any] = list(table.columns)
    budgets = sorted({budget for _, budget in columns})
    spaces = [
        {teacher: space.to_numpy()[rows] for teacher, rows in space.groupby("teacher").indices.items()}
        for _, space in table.groupby(STRATA)
    ]
    early, pairs = (HEADLINE, budgets[0]), list(itertools.combinations(range(len(means)), 2))
    for later in itertools.product((HEADLINE, FINAL), budgets[1:]):
        both = [columns.index(early), columns.index(later)]
        first, second = means[early].to_numpy(), means[later].to_numpy()
        yield BudgetAgreement(
            *later,
            effect_correlation([{name: rows[:, both] for name, rows in space.items()} for space in spaces]),
            float(stats.kendalltau(first, second).statistic),
            len(pairs),
            sum((first[i] - first[j]) * (second[i] - second[j]) < 0 for i, j in pairs),
        )

"""Agreement of the order of teachers after a small budget with their order after larger ones."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy import stats

from analysis.data.columns import CHALLENGE, STRATA
from analysis.data.frames import Frames
from analysis.formatting import number, steps_text
from analysis.measures.run_measures import evaluations_at
from analysis.measures.tested import FINAL, HEADLINE
from analysis.statistics import stratum_weights
from analysis.statistics.agreement import EffectCorrelation, effect_correlation

BUDGETS: Final = (2_000_000, 5_000_000, 10_000_000, 20_000_000)
"""Budgets that are compared, in steps, the early one first."""


@dataclass(frozen=True)
class BudgetAgreement:
    """Agreement of teachers' results at the early budget (`HEADLINE`) with a measure at a later one.

    Attributes:
        measure: `HEADLINE` or `FINAL`.
        budget: later budget, steps.
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
        interval = f" [{number(estimate.low, 2)}, {number(estimate.high, 2)}]" if not estimate.reason else ""
        return f"{number(estimate.value, 2)}{interval}"


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
        """Return a table row on a later budget: correlation and reversed pairs for `FINAL` and `HEADLINE`."""
        by_measure = {
            agreement.measure: agreement for agreement in self.agreements if agreement.budget == budget
        }
        later = [by_measure[FINAL], by_measure[HEADLINE]]
        pairs = [[str(agreement), f"{agreement.reversed_pairs} of {agreement.pairs}"] for agreement in later]
        return [steps_text(budget), *itertools.chain(*pairs)]

    def sentence(self) -> str:
        """Return a sentence on the agreement of the early budget with the last one."""
        last = self.agreements[-1]
        return (
            f"The order of teachers over training after {steps_text(self.budgets[0])} steps agrees with "
            f"that in the end after {steps_text(last.budget)} with a correlation of true effects of {last}; "
            f"{last.reversed_pairs} of {last.pairs} pairs change places."
        )


def compare_budgets(frames: Frames, runs: pd.DataFrame) -> BudgetComparison | None:
    """Compare a leaderboard's teachers at the `BUDGETS` that its runs reach; None for fewer than two.

    Args:
        frames: results with these runs.
        runs: rows of `pooling.pool_runs` of one leaderboard.
    """
    budgets = [budget for budget in BUDGETS if budget <= runs["steps"].min()]
    if len(budgets) < 2 or runs["teacher"].nunique() < 3:
        return None
    measured = evaluations_at(frames, budgets)[["run_id", "step", HEADLINE, FINAL]]
    rows = runs[["run_id", "teacher", *STRATA]].merge(measured, on="run_id")
    table = rows.pivot_table(index=["teacher", *STRATA, "run_id"], columns="step", values=[HEADLINE, FINAL])
    table = table.dropna().rename_axis(columns=["measure", "budget"])
    strata = table.groupby([*STRATA, "teacher"]).mean().unstack("teacher")
    weights = stratum_weights(list(strata.index.to_frame()[CHALLENGE].itertuples(index=False, name=None)))
    shares = np.array(weights) / sum(weights)
    overall = pd.Series(shares @ strata.to_numpy(), strata.columns).unstack(["measure", "budget"])
    order = overall[FINAL, budgets[-1]].sort_values(ascending=False, kind="stable").index
    return BudgetComparison(overall.loc[order], tuple(_agreements(table, overall, budgets)))


def _agreements(
    table: pd.DataFrame, means: pd.DataFrame, budgets: Sequence[int]
) -> Iterator[BudgetAgreement]:
    columns: list[Any] = list(table.columns)
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

"""Verdicts by intervals: closed cases, and error rates of the claims' relations by simulation."""

import math

import numpy as np
import pytest
from scipy import stats

from analysis.statistics.samples import Standing, contrary, equivalent, greater


@pytest.mark.parametrize(
    ("low", "high", "is_greater", "is_equivalent"),
    [
        (1.0, 20.0, Standing.SUPPORTED, Standing.REFUTED),
        (-20.0, -1.0, Standing.REFUTED, Standing.REFUTED),
        (-2.0, 3.0, Standing.REFUTED, Standing.SUPPORTED),
        (0.5, 3.0, Standing.SUPPORTED, Standing.SUPPORTED),
        (-8.0, 12.0, Standing.UNDECIDED, Standing.UNDECIDED),
        (-8.0, 4.0, Standing.REFUTED, Standing.UNDECIDED),
        (math.nan, math.nan, Standing.UNDECIDED, Standing.UNDECIDED),
    ],
)
def test_standings(low: float, high: float, is_greater: Standing, is_equivalent: Standing) -> None:
    assert greater(low, high) is is_greater
    assert equivalent(low, high) is is_equivalent
    assert equivalent(-high, -low) is is_equivalent
    assert contrary(contrary(greater(low, high))) is greater(low, high)


def intervals(difference: float, seeds: int, experiments: int) -> np.ndarray:
    rng = np.random.default_rng(5)
    first, second = rng.normal(difference, 10, (experiments, seeds)), rng.normal(0, 10, (experiments, seeds))
    found = stats.ttest_ind(first, second, axis=1, equal_var=False).confidence_interval(0.95)
    return np.column_stack([found.low, found.high])


@pytest.mark.parametrize("seeds", [3, 32])
def test_a_teacher_that_is_better_is_not_called_no_better_for_lack_of_seeds(seeds: int) -> None:
    # A difference of 10 points, a deviation of 10: few seeds leave it undecided, and do not refute it.
    standings = [greater(low, high) for low, high in intervals(10.0, seeds, 1_000)]
    assert standings.count(Standing.REFUTED) <= 0.025 * len(standings) + 10
    assert (standings.count(Standing.UNDECIDED) > 700) is (seeds == 3)


def test_equivalence_is_seldom_found_where_there_is_none() -> None:
    standings = [equivalent(low, high) for low, high in intervals(5.0, 32, 1_000)]
    assert standings.count(Standing.SUPPORTED) <= 0.025 * len(standings) + 10
    alike = [equivalent(low, high) for low, high in intervals(0.0, 200, 1_000)]
    assert alike.count(Standing.SUPPORTED) > 900

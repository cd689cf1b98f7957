"""Welch's t-test between results of which only numbers of seeds, means and deviations are known."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from analysis.comparisons.pairwise import check_reference, nobody, pairs_of
from analysis.data.arguments import check_columns
from analysis.measures.pooling import COMPARED
from analysis.statistics import Comparison, Description, holm, welch_from_statistics

WITHIN = [*COMPARED, "embodiments", "students"]
"""Columns that teachers must have in common to be compared, of those that a table has."""


def pairwise_from_statistics(
    table: pd.DataFrame,
    measure: str = "mastered_percent",
    reference: str | None = None,
    within: Sequence[str] = WITHIN,
) -> pd.DataFrame:
    """Returns Welch's t-test between teachers, one row a pair, as `pairwise.pairwise` does from runs.

    For published tables. Of our own results prefer the runs, which also tell whether two samples share some.

    Args:
        table: one row per teacher: teacher, n, `measure` with the endings _mean and _std, and those of
            `within` that there are.
        measure: what is compared.
        reference: the teacher that all others are tested against; None for all pairs.
        within: columns that teachers must have in common to be compared; absent ones do not matter.

    Returns:
        `within`, measure, first, second, the columns of `statistics.Comparison` for first minus second, and
        holm: p adjusted for all tests that have `within` in common.
    """
    check_columns("table", table, ["teacher", "n", f"{measure}_mean", f"{measure}_std"])
    check_reference(reference, table)
    within, rows = [column for column in within if column in table], []
    for key, group in table.groupby(within, dropna=False, sort=True) if within else [((), table)]:
        results = {
            str(teacher): Description(int(n), float(mean), float(std))
            for teacher, n, mean, std in group[
                ["teacher", "n", f"{measure}_mean", f"{measure}_std"]
            ].itertuples(index=False, name=None)
        }
        shared = dict(zip(within, key, strict=True)) | {"measure": measure}
        for first, second in pairs_of(sorted(results), reference):
            names = {"first": first, "second": second}
            rows.append(shared | names | vars(_compared(results[first], results.get(second), second)))
    columns = [*within, "measure", "first", "second", *Comparison.__dataclass_fields__]
    tests = pd.DataFrame(rows, columns=columns)
    families = tests.groupby(within, dropna=False)["p"] if within and len(tests) else None
    tests["holm"] = holm(tests["p"]) if families is None else families.transform(holm)
    return tests


def _compared(first: Description, second: Description | None, name: str) -> Comparison:
    if second is None:
        return Comparison(first.n, 0, float("nan"), reason=nobody(name))
    return welch_from_statistics(first, second)

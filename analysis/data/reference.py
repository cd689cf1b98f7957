"""The baseline teacher, Random: which of its runs the other teachers of a comparison are tested against."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from tma_ray.tasks import KnowledgeLevel

BASELINE = "random"
"""The teacher that all others are tested against (paper, section 5)."""

NO_BASELINE = "no Random to compare with"
"""Why a teacher was not tested, when that is it."""

_RANKS = {level.value: level.rank for level in KnowledgeLevel}


def is_baseline(teacher: str) -> bool:
    """Tells whether `teacher` is the Random baseline."""
    return teacher.lower() == BASELINE


def baseline_rows(rows: pd.DataFrame) -> pd.DataFrame:
    """Returns those of Random."""
    names = {teacher: is_baseline(teacher) for teacher in rows["teacher"].unique()}
    return rows[rows["teacher"].map(names).astype(bool)]


def baseline_runs(
    group: pd.DataFrame, alike: pd.DataFrame, apart: Sequence[str] = ("expert_knowledge",)
) -> pd.DataFrame:
    """Returns the runs of Random that the teachers of one comparison are tested against.

    Random uses no expert knowledge, and whose campaign it ran in makes no difference. So where the comparison
    has none of its own, those of one other place serve: of the same experiment if it has any, and of the
    lowest level.

    Args:
        group: rows of the comparison, with teacher, expert_knowledge and `apart`.
        alike: rows that agree with them in all that makes a difference, with the same columns.
        apart: columns that tell comparisons apart and make no difference to Random.
    """
    own, found = baseline_rows(group), baseline_rows(alike)
    if len(own) or found.empty:
        return own
    here = group.iloc[0]
    others = [column for column in apart if column != "expert_knowledge"]
    places = found[list(apart)].drop_duplicates()
    order = [
        (
            *(row[column] != here[column] for column in others),
            _RANKS[row["expert_knowledge"]],
            *row.astype(str),
        )
        for _, row in places.iterrows()
    ]
    nearest = places.iloc[order.index(min(order))]
    return found[(found[list(apart)] == nearest).all(axis=1)]

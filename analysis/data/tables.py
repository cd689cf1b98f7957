"""Tables of results: checks of their columns, plain texts, and measures of each evaluation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tma_ray.arguments import check_kind, check_known, check_names


def check_columns(name: str, table: object, columns: Sequence[str]) -> None:
    """Refuse the argument `name` if it is not a table with these columns.

    Raises:
        TypeError: it is not a table, or `columns` is one text.
        ValueError: it lacks a column; the message holds the nearest one.
    """
    check_kind(name, table, pd.DataFrame, "a table, as from analysis.runs_after(frames)")
    check_names("columns", columns)
    assert isinstance(table, pd.DataFrame)
    for column in columns:
        check_known("column", column, table.columns, f"{name} has")


def check_measure(name: str, table: object, measure: str, columns: Sequence[str]) -> None:
    """Refuse what is not a table with `columns` and the numbers of a `measure`.

    Raises:
        TypeError: errors of `check_columns`.
        ValueError: it lacks a column, or `measure` is none of numbers.
    """
    check_columns(name, table, [measure, *columns])
    assert isinstance(table, pd.DataFrame)
    values = table[measure].dropna()
    if len(values) and not pd.api.types.is_numeric_dtype(values.infer_objects()):
        raise ValueError(f"column {measure!r} is not a measure: {values.iloc[0]!r} is not a number")


def with_plain_texts(frame: pd.DataFrame) -> pd.DataFrame:
    """Return `frame` with its texts and categories as Python strings, missing ones as they are.

    Names are few and short, and tables are grouped by a dozen of them again and again: pandas takes and
    groups Arrow's strings several times more slowly than objects, and merging unequal categories is fragile.
    """
    texts = frame.select_dtypes(["category", "str"]).columns
    return frame.astype(dict.fromkeys(texts, object))


SHOWN_RUNS = 3
"""Runs that a warning names."""


def evaluation_measures(evaluations: pd.DataFrame) -> pd.DataFrame:
    """Return one row per run and evaluation: run_id, step, the measures, tasks, and not_finite.

    An evaluation that has any return that is NaN or infinite has no measures (NaN): mastered % is of all test
    tasks, and a missing return is neither a failure nor a success. not_finite is the number of such returns.

    Rows of one evaluation mostly follow each other: they are added up before they are grouped, since a full
    benchmark has tens of millions.

    Args:
        evaluations: run_id, step, episodic_return and mastered (bool) of each test task.
    """
    run_ids, steps = evaluations["run_id"].astype("category"), evaluations["step"].to_numpy()
    codes = run_ids.cat.codes.to_numpy()
    change = (codes[1:] != codes[:-1]) | (steps[1:] != steps[:-1])
    starts = np.concatenate([[0], np.flatnonzero(change) + 1])[: len(steps)]
    returns = evaluations["episodic_return"].to_numpy(float)
    finite = np.isfinite(returns)

    def sums(values: NDArray[np.number]) -> NDArray[np.number]:
        return np.add.reduceat(values, starts) if len(starts) else np.zeros(0, values.dtype)

    table = pd.DataFrame(
        {
            "run_id": np.asarray(run_ids.cat.categories, dtype=object)[codes[starts]],
            "step": steps[starts],
            "mastered_percent": sums(100.0 * evaluations["mastered"].to_numpy()),
            "evaluation_return": sums(returns if finite.all() else np.where(finite, returns, 0.0)),
            "tasks": np.diff(starts, append=len(steps)),
            "not_finite": sums((~finite).astype(np.int64)),
        }
    )
    found = table.groupby(["run_id", "step"], sort=True).sum().reset_index()
    for measure in ("mastered_percent", "evaluation_return"):
        found[measure] = (found[measure] / found["tasks"]).where(found["not_finite"] == 0)
    return found.astype({"run_id": object})


def evaluation_warnings(measured: pd.DataFrame) -> list[str]:
    """Return a sentence on the returns that are NaN or infinite in rows of `evaluation_measures`."""
    excluded = measured[measured["not_finite"] > 0]
    if excluded.empty:
        return []
    return [
        f"{excluded['not_finite'].sum():,} returns of {_count(len(excluded), 'evaluation')} are NaN or "
        f"infinite; these evaluations are excluded ({_named(excluded['run_id'])})."
    ]


def training_warnings(training: pd.DataFrame) -> list[str]:
    """Return a sentence on the windows of training whose mean return is NaN or infinite."""
    windows = training[training["mean_return"].notna() & ~np.isfinite(training["mean_return"].astype(float))]
    nans = training[training["mean_return"].isna() & (training["episodes"] > 0)]
    if not len(windows) + len(nans):
        return []
    runs = pd.concat([windows["run_id"], nans["run_id"]]).astype(str)
    return [
        f"{_count(len(windows) + len(nans), 'window')} of training with a mean return that is NaN or "
        f"infinite: excluded ({_named(runs)})."
    ]


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}{'s' if number > 1 else ''}"


def _named(run_ids: pd.Series) -> str:
    runs = sorted(set(run_ids))
    more = f" and {len(runs) - SHOWN_RUNS} more" if len(runs) > SHOWN_RUNS else ""
    return f"{_count(len(runs), 'run')}: {', '.join(runs[:SHOWN_RUNS])}{more}"

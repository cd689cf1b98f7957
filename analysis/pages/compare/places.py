"""A place of a comparison with baselines, such as a challenge at a level, with all that may be compared."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.comparisons.few_seeds import caveat
from analysis.comparisons.ranking import places as titles_of
from analysis.formatting import ends, number, p_value, plus_minus
from analysis.looks import look
from analysis.measures.evaluations import aggregate
from analysis.measures.pooling import COMPARED, pooled
from analysis.measures.tested import MEASURE, QUANTITIES
from analysis.measures.variants import parts_of
from analysis.names import label, mark_of, marked_label
from analysis.pages.charts import END, Chart, curve_chart, overview_chart, seeds_chart


@dataclass(frozen=True, eq=False)
class Place:
    """Where teachers of one's own have results, and those that may be compared with them.

    Attributes:
        anchor: identifier on the page.
        title: challenge, students and level.
        chosen_by: its values in the columns that readers choose by.
        rows: cells of the ranking, the best teacher first.
        step_rows: JSON of what changes of them at every evaluation.
        points: teacher, seed, step (or `charts.END`) and value of every run.
        charts: learning curves, and seed by seed.
    """

    anchor: str
    title: str
    chosen_by: dict[str, str]
    rows: list[dict[str, Any]]
    step_rows: str
    points: pd.DataFrame
    charts: tuple[Chart, ...]


def places(
    runs: pd.DataFrame, curves: pd.DataFrame, tests: pd.DataFrame, measure: str = MEASURE
) -> Iterator[Place]:
    """Yields each place with its ranking and charts.

    Args:
        runs: of `compare.together`, at their ends.
        curves: of `compare.together`, at every evaluation.
        tests: of `compare.duels`.
        measure: of `tested.MEASURES`; learning curves are always of mastered tasks.
    """
    if runs.empty:
        return
    sources = runs.groupby([*COMPARED, "teacher"], dropna=False)["source"].agg("first").reset_index()
    table = pooled(runs, [measure]).merge(sources, on=[*COMPARED, "teacher"])
    table = table.assign(title=titles_of(table))
    for count, (key, rows) in enumerate(table.groupby(COMPARED, dropna=False, sort=True), start=1):
        place = dict(zip(COMPARED, key, strict=True))
        here, ends, along = (_at(frame, place) for frame in (tests, runs, curves))
        ranked = rows.sort_values(f"{measure}_mean", ascending=False, na_position="last")
        points, anchor = _points(ends, along, measure), f"place-{count}"
        yield Place(
            anchor=anchor,
            title=_title(rows["title"].iloc[0], place),
            chosen_by={name: str(place[name]) for name in ("environment", "challenge", "expert_knowledge")}
            | {"student": _students(place)},
            rows=[_ranked(row, here, measure) for _, row in ranked.iterrows()],
            step_rows=json.dumps(_step_rows(along) if measure == MEASURE else {}).replace("<", "\\u003c"),
            points=points.assign(comparison=anchor),
            charts=tuple(_charts(anchor, points, measure)),
        )


def places_chart(found: list[Place], measure: str = MEASURE) -> Iterator[Chart]:
    """Yields the chart of all places at once, if there are several."""
    if len(found) > 1:
        points = pd.concat([place.points for place in found], ignore_index=True)
        points = points if measure == MEASURE else points[points["step"] == END]
        titles = {place.anchor: place.title for place in found}
        caption = "Marks are means over runs, lines their 95 % intervals, of results that may be compared."
        few = caveat(points.groupby(["comparison", "teacher"])["seed"].nunique().min())
        caption += f" {few}" if few else ""
        yield overview_chart(points, titles, QUANTITIES[measure], "All challenges", caption)


def _at(frame: pd.DataFrame, place: dict[str, Any]) -> pd.DataFrame:
    fits = np.ones(len(frame), dtype=bool)
    for column, value in place.items():
        fits &= (frame[column].isna() if pd.isna(value) else frame[column] == value).to_numpy(bool)
    return frame[fits]


def _points(ends: pd.DataFrame, along: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Returns teacher, seed, step (or `END`) and value of every run that was evaluated."""
    curves = along[along["step"].notna()].astype({"step": int}).astype({"step": object})
    parts = [
        rows[["teacher", "seed", "step", column]].rename(columns={column: "value"})
        for rows, column in ((curves, MEASURE), (ends.assign(step=END), measure))
    ]
    table = pd.concat(parts, ignore_index=True)
    return table[table["value"].notna()]


def _charts(anchor: str, points: pd.DataFrame, measure: str) -> Iterator[Chart]:
    if points.empty:
        return
    along = points[points["step"] != END].astype({"step": "int64"})
    if along["step"].nunique() > 1:
        table = aggregate(along, "value", ["teacher"])
        caption = "Lines are means over runs, bands ± one standard error of the mean."
        title = "Mastered test tasks over training"
        yield curve_chart(f"{anchor}-curves", table, QUANTITIES[MEASURE], title, caption)
    caption = "Rings are runs, marks their means with 95 % intervals."
    shown = points if measure == MEASURE else points[points["step"] == END]
    yield seeds_chart(f"{anchor}-runs", shown, QUANTITIES[measure], "Run by run", caption)


def _step_rows(along: pd.DataFrame) -> dict[str, dict[str, dict[str, str]]]:
    """Returns runs and mastered tasks of every teacher at every evaluation, as text."""
    found: dict[str, dict[str, dict[str, str]]] = {}
    known = along[along["step"].notna() & along[MEASURE].notna()]
    for _, rows in known.groupby(["step", "teacher"], sort=True):
        values, first = rows[MEASURE], rows.iloc[0]
        texts = {"n": str(len(values)), "mastered": plus_minus(values.mean(), values.std()), "tests": ""}
        found.setdefault(str(int(first["step"])), {})[str(first["teacher"])] = texts
    return found


def _students(place: dict[str, Any]) -> str:
    return " and ".join(sorted({student.upper() for _, student in parts_of(place["pool"])}))


def _title(challenge: str, place: dict[str, Any]) -> str:
    return f"{challenge}, {_students(place)}, expert knowledge {place['expert_knowledge']}"


def _ranked(row: pd.Series, tests: pd.DataFrame, measure: str) -> dict[str, Any]:
    against = tests[tests["second"] == row["teacher"]]
    return {
        "name": row["teacher"],
        "teacher": marked_label(row["teacher"]),
        "colour": look(row["teacher"]).colour,
        "source": row["source"],
        "own": mark_of(row["teacher"]) != "",
        "n": row["n"],
        "mastered": plus_minus(row[f"{measure}_mean"], row[f"{measure}_std"]),
        "missing": row["missing"],
        "tests": [_test(test) for _, test in against.iterrows()],
    }


def _test(test: pd.Series) -> str:
    first = label(test["first"])
    if test["reason"]:
        return f"{first}: not tested ({test['reason']})"
    interval = f"{number(test['difference'])} {ends(test['low'], test['high'])}"
    return f"{first} {interval}, {p_value(test['p'])}, {p_value(test['holm']).replace('p', 'Holm', 1)}"

"""The page that puts one's own results next to released ones."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from analysis.baselines.catalogue import Sources, places_of, read
from analysis.charts.base import END, MASTERED
from analysis.charts.curves import learning_curves
from analysis.charts.intervals import overview_chart, rank_chart, seeds_chart
from analysis.charts.page import PageChart, on_page
from analysis.charts.paper import Picture, draw
from analysis.charts.radars import radar
from analysis.claims.judging import decided, root_verdicts
from analysis.comparisons.boards import Rank, headlines, ranks
from analysis.comparisons.frame import pairwise, pairwise_from_statistics
from analysis.comparisons.planning import plans_against_random
from analysis.comparisons.sentences import caveat, sentences
from analysis.comparisons.sentences import places as titles_of
from analysis.comparisons.sides import (
    PLACE,
    Side,
    baseline_side,
    beside,
    duels,
    incomparable,
    missing,
    named_jointly,
    new_teachers,
    side_of,
    together,
)
from analysis.data.frames import Frames
from analysis.data.reference import PAPER
from analysis.formatting import amount, ends, listed, number, p_value, plus_minus
from analysis.looks import look, shown_together
from analysis.measures.evaluations import aggregate
from analysis.measures.pooling import COMPARED, SETTINGS, by_students, parts_of, pooled
from analysis.measures.tested import FINAL, HEADLINE, MEASURES, PAPERS, QUANTITIES, how_tested
from analysis.names import label, mark_of, marked_label, own_first, teacher_order
from analysis.pages.page import (
    SHOWN,
    Controls,
    controls,
    leading,
    overall_section,
    page,
    page_folder,
    write_page,
)
from analysis.statistics import SIGNIFICANCE
from analysis.tables.paper_tables import TableResults, result_tables, results_of
from analysis.tables.table import Table
from tma_ray.commands.exits import installed_version


@dataclass(frozen=True, eq=False)
class Place:
    """A challenge and level with results of the reader's teachers and of comparable ones.

    Attributes:
        anchor: identifier on the page.
        title: challenge, students and level.
        chosen_by: its values in the columns that readers choose by.
        rows: cells of the ranking, the best teacher first.
        step_rows: JSON of their changes at every evaluation.
        points: teacher, seed, step (or `END`) and value of every run.
        charts: learning curves, and seed by seed.
    """

    anchor: str
    title: str
    chosen_by: dict[str, str]
    rows: list[dict[str, Any]]
    step_rows: str
    points: pd.DataFrame
    charts: tuple[PageChart, ...]


def places(
    runs: pd.DataFrame, curves: pd.DataFrame, tests: pd.DataFrame, measure: str = HEADLINE
) -> Iterator[Place]:
    """Yield each place with its ranking and charts.

    Args:
        runs: runs of `sides.together`, at their ends.
        curves: runs of `sides.together`, at every evaluation.
        tests: tests of `sides.duels`.
        measure: one of `tested.MEASURES`; learning curves are of each evaluation.
    """
    if runs.empty:
        return
    sources = runs.groupby([*COMPARED, "teacher"], dropna=False)["source"].agg("first").reset_index()
    table = pooled(runs, list(dict.fromkeys([measure, FINAL]))).merge(sources, on=[*COMPARED, "teacher"])
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
            step_rows=json.dumps(_step_rows(along, measure)).replace("<", "\\u003c"),
            points=points.assign(comparison=anchor),
            charts=tuple(_charts(anchor, points, along, measure)),
        )


def places_chart(found: list[Place], measure: str = HEADLINE) -> Iterator[PageChart]:
    """Yield the chart of all places at once, if there are several."""
    if len(found) > 1:
        points = pd.concat([place.points for place in found], ignore_index=True)
        titles = {place.anchor: place.title for place in found}
        caption = "Marks are means over runs, lines their 95 % intervals, of results that may be compared."
        few = caveat(points.groupby(["comparison", "teacher"])["seed"].nunique().min())
        caption += f" {few}" if few else ""
        yield on_page(overview_chart(points, titles, QUANTITIES[measure], "All challenges", caption))


def _at(frame: pd.DataFrame, place: dict[str, Any]) -> pd.DataFrame:
    fits = np.ones(len(frame), dtype=bool)
    for column, value in place.items():
        fits &= (frame[column].isna() if pd.isna(value) else frame[column] == value).to_numpy(bool)
    return frame[fits]


def _points(ends: pd.DataFrame, along: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Return teacher, seed, step (or `END`) and value of every run that was evaluated."""
    curves = along[along["step"].notna()].astype({"step": int}).astype({"step": object})
    parts = [
        rows[["teacher", "seed", "step", measure]].rename(columns={measure: "value"})
        for rows in (curves, ends.assign(step=END))
    ]
    table = pd.concat(parts, ignore_index=True)
    return table[table["value"].notna()]


def _charts(anchor: str, points: pd.DataFrame, along: pd.DataFrame, measure: str) -> Iterator[PageChart]:
    if points.empty:
        return
    along = along[along["step"].notna() & along[PAPERS].notna()].astype({"step": "int64"})
    if along["step"].nunique() > 1:
        table = aggregate(along, PAPERS, ["teacher"])
        caption = "Lines are means over runs, bands ± one standard error of the mean."
        title = "Mastered test tasks at each evaluation"
        yield on_page(learning_curves(table, MASTERED, f"{anchor}-curves", title, caption))
    caption = "Rings are runs, marks their means with 95 % intervals."
    yield on_page(seeds_chart(points, QUANTITIES[measure], f"{anchor}-runs", "Run by run", caption))


def _step_rows(along: pd.DataFrame, measure: str) -> dict[str, dict[str, dict[str, str]]]:
    """Return runs and mastered tasks of every teacher at every evaluation, as text."""
    found: dict[str, dict[str, dict[str, str]]] = {}
    known = along[along["step"].notna() & along[measure].notna()]
    for _, rows in known.groupby(["step", "teacher"], sort=True):
        values, first = rows[measure], rows.iloc[0]
        texts = {"n": str(len(values)), "mastered": plus_minus(values.mean(), values.std())}
        texts |= {"final": number(rows[FINAL].mean()), "tests": ""}
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
        "final": number(row[f"{FINAL}_mean"]),
        "missing": row["missing"],
        "tests": [_test(test) for _, test in against.iterrows()],
    }


def _test(test: pd.Series) -> str:
    first = label(test["first"])
    if test["reason"]:
        return f"{first}: not tested ({test['reason']})"
    interval = f"{number(test['difference'])} {ends(test['low'], test['high'])}"
    return f"{first} {interval}, {p_value(test['p'])}, {p_value(test['holm']).replace('p', 'Holm', 1)}"


def write_comparison(
    sources: Sources,
    baselines: Sequence[str],
    output: Path | None = None,
    tell: Callable[[str], object] | None = None,
    measure: str = HEADLINE,
) -> Path:
    """Write a page that compares the results of a root with baselines; return its ``index.html``.

    Args:
        sources: results of one's own, finished or not: one root or several.
        baselines: names of released baselines, folders or addresses of results.
        output: folder for pages, each in a folder named by its baselines; ``compare`` in the first of
            `sources` if that is a folder.
        tell: function that is called with the first sentences of the page: results that cannot be compared,
            ranks over all challenges, and runs that would distinguish a teacher from Random.
        measure: one of `tested.MEASURES`, by which teachers are ranked and tested.

    Raises:
        ResultsRootError: one of `sources` or a baseline is not a results root.
        ValueError: no baseline, or an object store and no `output`.
    """
    if not baselines:
        raise ValueError(f"compare with what? Name a baseline, as in --baseline {PAPER}")
    folder = page_folder(places_of(sources)[0], output, "compare", "page") / _folder_name(baselines)
    text, pictures = _render(read(sources), baselines, tell, measure)
    return write_page(folder, text, {f"{picture.name}.png": picture.png for picture in pictures})


def _render(
    frames: Frames, baselines: Sequence[str], tell: Callable[[str], object] | None, measure: str
) -> tuple[str, list[Picture]]:
    """Return the page, and the figures on it."""
    mine, others, split = named_jointly(side_of(frames, "yours"), [baseline_side(name) for name in baselines])
    runs, curves = together(mine, others), together(mine, others, along=True)
    teachers = new_teachers(mine)
    ranked = ranks(runs, teachers, measure)
    standings = [*incomparable(mine, others, runs), *(rank.describe() for rank in ranked)]
    plans = plans_against_random(runs, teachers, _hours(frames, others), measure)
    _tell([*standings, *plans], tell)
    tests = duels(runs, teachers, measure)
    shown = leading(pooled(runs, [measure]), f"{measure}_mean", runs["teacher"], COMPARED)
    shown |= frozenset(teachers if len(teachers) <= SHOWN else ())
    verdicts, notes = root_verdicts(frames)
    with shown_together(runs["teacher"]), own_first(teachers):
        found = list(places(runs, curves, tests, measure))
        text = page(
            "compare.html.j2",
            mine=mine,
            teachers=listed(map(label, teachers)),
            others=others,
            sentences=sentences(tests),
            missing=missing(mine, teachers),
            places=found,
            overview=list(places_chart(found, measure)),
            controls=_controls(found, runs, curves, shown),
            beside=[(side, _beside_rows(beside(mine, side))) for side in others],
            pictures=(pictures := list(_radars(runs[runs["teacher"].isin(shown)], others))),
            tables=list(_tables(runs)),
            standings=standings,
            ranks=[on_page(rank_chart(boards))] if (boards := _boards(ranked)) else [],
            headlines=headlines(runs, measure, teachers),
            plans=plans,
            overall=overall_section(runs, measure),
            warnings=list(dict.fromkeys([*frames.notes, *split, *notes])),
            verdicts=decided(verdicts),
            quantity=QUANTITIES[measure],
            head=MEASURES[measure].capitalize(),
            papers=QUANTITIES[PAPERS],
            how_tested=how_tested(measure, "all teachers that one of yours is set against on a challenge"),
            significance=SIGNIFICANCE,
            version=installed_version("tma_ray"),
            written=datetime.now(UTC),
        )
    return text, pictures


def _boards(ranked: Sequence[Rank]) -> dict[str, list[Rank]]:
    """Return the ranks of each level and budget on as many challenges, by conditions and challenges."""
    found: dict[str, list[Rank]] = {}
    for rank in ranked:
        if rank.of > 1:
            level, steps = rank.across["expert_knowledge"], amount(rank.across["steps"])
            where = f"expert knowledge {level}, {steps} steps"
            which = f"{rank.of} teachers on {rank.challenges} challenges"
            found.setdefault(f"{where}: {which}", []).append(rank)
    return found


def _folder_name(baselines: Sequence[str]) -> str:
    """Return the name of the folder of a page, so that no page replaces that of other baselines."""
    return "+".join(re.sub(r"[^\w.-]+", "_", str(name)).strip("_.") or "_" for name in baselines)


def _hours(frames: Frames, others: Sequence[Side]) -> pd.Series:
    """Return the hours of all runs by id."""
    known = [frames, *(side.frames for side in others if side.frames is not None)]
    hours: pd.Series = pd.concat([each.run_hours for each in known])
    return hours[~hours.index.duplicated()]


def _controls(
    found: Sequence[Place], runs: pd.DataFrame, curves: pd.DataFrame, shown: Collection[str]
) -> Controls:
    chosen = pd.DataFrame([place.chosen_by for place in found])
    return controls(chosen, runs["teacher"], curves["step"].dropna(), shown)


def _tell(standings: Sequence[str], tell: Callable[[str], object] | None) -> None:
    if tell is not None:
        for sentence in standings:
            tell(sentence)


def _radars(runs: pd.DataFrame, others: Sequence[Side]) -> Iterator[Picture]:
    """Yield the radar of comparable results, and one of each published table."""
    kinds = [*SETTINGS, "students"]
    students = runs["pool"].map(lambda pool: ", ".join(sorted({student for _, student in parts_of(pool)})))
    for place, (_, group) in enumerate(runs.assign(students=students).groupby(kinds, dropna=False), start=1):
        table, tests = pooled(group, [PAPERS]), pairwise(group, PAPERS, "random", detectable=False)
        caption = "Your results and what may be compared with them, as ratios of Random."
        yield from _radar(f"radar-{place}", table, tests, "Yours among comparable baselines", caption)
    for side in others:
        if side.runs is None:
            tests = pairwise_from_statistics(side.table, PAPERS, "random")
            caption = f"The tables of {side.name} ({side.engine}), set beside: ratios of its own Random."
            yield from _radar(f"radar-{side.name}", side.table, tests, side.name, caption)


def _tables(runs: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Yield the paper's tables of comparable results, as text by row and column."""
    for _, alike in runs.groupby(SETTINGS, dropna=False):
        for _, matrices, chosen in by_students(alike):
            both = pd.concat([pooled(chosen), pooled(chosen, by=["embodiment"])], ignore_index=True)
            for table in result_tables(TableResults(results_of(both), matrices)):
                rows = [
                    (row, named, [_cell(table, row, column) for column in table.columns])
                    for row, named in table.rows.items()
                ]
                notes = [f"{mark}: {text}" for text, mark in table.notes().items()]
                columns = list(table.columns.values())
                yield {"title": table.title, "columns": columns, "rows": rows, "notes": notes}


def _cell(table: Table, row: str, column: str) -> dict[str, Any]:
    cell, marks = table.cell(row, column), table.notes()
    text = plus_minus(cell.mean, cell.std, cell.digits) if cell.has_number else "\N{EN DASH}"
    return {"text": text, "best": cell.best, "marks": ", ".join(marks[note] for note in cell.notes)}


def _radar(
    name: str, table: pd.DataFrame, tests: pd.DataFrame, title: str, caption: str
) -> Iterator[Picture]:
    try:
        figure = draw(radar(table, tests))
    except ValueError:  # no challenge of Stump Tracks, or no results yet
        return
    yield Picture.of(name, figure, title, caption)


def _beside_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    rows = table.assign(order=table["teacher"].map(teacher_order)).sort_values([*PLACE, "order"])
    return [
        {
            "place": f"{row['environment']} {row['challenge']}, {row['expert_knowledge']}".replace("_", " "),
            "teacher": label(row["teacher"]),
            "n": row["n"],
            "mastered": plus_minus(row[f"{PAPERS}_mean"], row[f"{PAPERS}_std"]),
            "differs": row["differs"],
        }
        for _, row in rows.iterrows()
    ]

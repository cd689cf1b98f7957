"""The page that puts one's own results beside released ones."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd

from analysis.baselines.sources import Sources, places_of, read
from analysis.claims.sources import decided, root_verdicts
from analysis.comparisons.overall import headlines
from analysis.comparisons.pairwise import pairwise
from analysis.comparisons.pairwise_statistics import pairwise_from_statistics
from analysis.comparisons.planning import plans_against_random
from analysis.comparisons.ranks import ranks
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
    sentences,
    side_of,
    together,
)
from analysis.data.frames import Frames
from analysis.data.published import PAPER
from analysis.figures.picture import Picture
from analysis.figures.radars.chart import radar
from analysis.formatting import listed, plus_minus
from analysis.looks import shown_together
from analysis.measures.pooling import COMPARED, SETTINGS, pooled
from analysis.measures.student_pools import by_students
from analysis.measures.tested import MEASURE, QUANTITIES, how_tested
from analysis.measures.variants import parts_of
from analysis.names import label, own_first, teacher_order
from analysis.pages.compare.places import Place, places, places_chart
from analysis.pages.controls import Controls, controls
from analysis.pages.leading import SHOWN, leading
from analysis.pages.overall import overall_section
from analysis.pages.page import page, page_folder, write_page
from analysis.statistics import SIGNIFICANCE
from analysis.tables.paper_tables import result_tables
from analysis.tables.results import TableResults, results_of
from analysis.tables.table import Table
from tma_ray.commands.installed import installed_version


def write_comparison(
    sources: Sources,
    baselines: Sequence[str],
    output: Path | None = None,
    tell: Callable[[str], object] | None = None,
    measure: str = MEASURE,
) -> Path:
    """Writes a page that compares the results of a root with baselines; returns its ``index.html``.

    Args:
        sources: results of one's own, finished or not: one root or several.
        baselines: names of released baselines, folders or addresses of results.
        output: folder for pages, each in a folder named by its baselines; ``compare`` in the first of
            `sources` if that is a folder.
        tell: is called with what the page says first: what cannot be compared, ranks over all challenges,
            and what would tell a teacher from Random.
        measure: of `tested.MEASURES`, that teachers are ranked by and tested on.

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
    """Returns the page, and the figures on it."""
    mine, others, split = named_jointly(side_of(frames, "yours"), [baseline_side(name) for name in baselines])
    runs, curves = together(mine, others), together(mine, others, along=True)
    teachers = new_teachers(mine)
    standings = [*incomparable(mine, others, runs), *(r.describe() for r in ranks(runs, teachers, measure))]
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
            headlines=headlines(runs, measure, teachers),
            plans=plans,
            overall=overall_section(runs, measure),
            warnings=list(dict.fromkeys([*frames.notes, *split, *notes])),
            verdicts=decided(verdicts),
            quantity=QUANTITIES[measure],
            how_tested=how_tested(measure, "all teachers that one of yours is set against on a challenge"),
            significance=SIGNIFICANCE,
            version=installed_version("tma_ray"),
            written=datetime.now(UTC),
        )
    return text, pictures


def _folder_name(baselines: Sequence[str]) -> str:
    """Returns the name of the folder of a page, so that no page replaces that of other baselines."""
    return "+".join(re.sub(r"[^\w.-]+", "_", str(name)).strip("_.") or "_" for name in baselines)


def _hours(frames: Frames, others: Sequence[Side]) -> pd.Series:
    """Returns the hours of all runs by id."""
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
    """Yields the radar of what may be compared, and one of each published table."""
    kinds = [*SETTINGS, "students"]
    students = runs["pool"].map(lambda pool: ", ".join(sorted({student for _, student in parts_of(pool)})))
    for place, (_, group) in enumerate(runs.assign(students=students).groupby(kinds, dropna=False), start=1):
        table, tests = pooled(group, [MEASURE]), pairwise(group, MEASURE, "random", detectable=False)
        caption = "Your results and what may be compared with them, as ratios of Random."
        yield from _radar(f"radar-{place}", table, tests, "Yours among comparable baselines", caption)
    for side in others:
        if side.runs is None:
            tests = pairwise_from_statistics(side.table, MEASURE, "random")
            caption = f"The tables of {side.name} ({side.engine}), set beside: ratios of its own Random."
            yield from _radar(f"radar-{side.name}", side.table, tests, side.name, caption)


def _tables(runs: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Yields the paper's tables of what may be compared, as text by row and column."""
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
        figure = radar(table, tests)
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
            "mastered": plus_minus(row[f"{MEASURE}_mean"], row[f"{MEASURE}_std"]),
            "differs": row["differs"],
        }
        for _, row in rows.iterrows()
    ]

"""The page that puts one's own results next to released ones."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from analysis.baselines.catalogue import Sources, read, source_list
from analysis.charts.base import MASTERED, Chart
from analysis.charts.curves import learning_curves
from analysis.charts.intervals import rank_chart, seeds_chart
from analysis.charts.page import on_page
from analysis.charts.paper import Picture, draw
from analysis.charts.radars import radar
from analysis.claims.judging import decided, root_verdicts
from analysis.comparisons import sides
from analysis.comparisons.against_random import Gap, against_random, sentences_against_random
from analysis.comparisons.frame import pairwise, pairwise_from_statistics
from analysis.comparisons.planning import plans_against_random
from analysis.comparisons.ranks import Rank, ranks
from analysis.comparisons.sentences import places as titles_of
from analysis.comparisons.sentences import sentences
from analysis.comparisons.verdicts import AXES
from analysis.data.columns import CHALLENGE_LEVEL, COMPARED, SETTINGS
from analysis.data.frames import Frames
from analysis.data.reference import PAPER
from analysis.formatting import amount, listed, number, p_value, plus_minus
from analysis.looks import shown_together
from analysis.measures.evaluations import aggregate
from analysis.measures.pooling import by_students, parts_of, pooled
from analysis.measures.tested import FINAL, HEADLINE, MEASURES, PAPERS, QUANTITIES, how_tested
from analysis.names import label, own_first, teacher_order
from analysis.pages.page import SHOWN, controls, leading, overall_section, page, page_folder, write_page
from analysis.pages.sections import Columns, Section, by_step, overview, points_of
from analysis.statistics import describe
from analysis.tables.paper_tables import TableResults, result_tables, results_of
from analysis.tables.table import ResultTable


def places(
    runs: pd.DataFrame, curves: pd.DataFrame, tests: pd.DataFrame, measure: str = HEADLINE
) -> Iterator[Section]:
    """Yield each challenge and level with results of the reader's teachers and of comparable ones.

    Args:
        runs: runs of `sides.together`, at their ends.
        curves: runs of `sides.together`, at every evaluation.
        tests: tests of `sides.duels`.
        measure: one of `tested.MEASURES`; learning curves are of each evaluation.
    """
    if runs.empty:
        return

    def texts(_step: int, _teacher: str, rows: Columns) -> dict[str, str]:
        values, final = describe(rows[measure]), describe(rows[FINAL])
        mastered = plus_minus(values.mean, values.std)
        return {"n": str(values.n), "mastered": mastered, "final": number(final.mean), "tests": ""}

    sources = runs.groupby([*COMPARED, "teacher"], dropna=False)["source"].agg("first").reset_index()
    table = pooled(runs, list(dict.fromkeys([measure, FINAL]))).merge(sources, on=[*COMPARED, "teacher"])
    table = table.assign(title=titles_of(table))
    for count, (key, rows) in enumerate(table.groupby(COMPARED, dropna=False, sort=True), start=1):
        place: dict[str, Any] = dict(zip(COMPARED, key, strict=True))
        here, ends, along = (_at(frame, place) for frame in (tests, runs, curves))
        ranked = rows.sort_values(f"{measure}_mean", ascending=False, na_position="last")
        along = along[along["step"].notna()].astype({"step": "int64"})
        points, anchor = points_of(along, ends, measure), f"place-{count}"
        points = points[points["value"].notna()]
        students = " and ".join(sorted({label(student) for _, student in parts_of(place["pool"])}))
        chosen_by = {name: str(place[name]) for name in ("environment", "challenge", "expert_knowledge")}
        yield Section(
            anchor=anchor,
            title=f"{rows['title'].iloc[0]}, {students}, expert knowledge {place['expert_knowledge']}",
            chosen_by=chosen_by | {"student": students},
            rows=[_ranked(row, here, measure) for _, row in ranked.iterrows()],
            step_rows=by_step(
                along.loc[along[measure].notna(), list({"step", "teacher", measure, FINAL})], texts
            ),
            points=points,
            charts=list(map(on_page, _charts(anchor, points, along, measure))),
        )


def _at(frame: pd.DataFrame, place: Mapping[str, Any]) -> pd.DataFrame:
    fits = np.ones(len(frame), dtype=bool)
    for column, value in place.items():
        fits &= (frame[column].isna() if pd.isna(value) else frame[column] == value).to_numpy(bool)
    return frame[fits]


def _charts(anchor: str, points: pd.DataFrame, along: pd.DataFrame, measure: str) -> Iterator[Chart]:
    if points.empty:
        return
    along = along[along[PAPERS].notna()]
    if along["step"].nunique() > 1:
        table = aggregate(along, PAPERS, ["teacher"])
        caption = "Lines are means over runs, bands ± one standard error of the mean."
        title = "Mastered test tasks at each evaluation"
        yield learning_curves(table, MASTERED, f"{anchor}-curves", title, caption)
    caption = "Rings are runs, marks their means with 95 % intervals."
    yield seeds_chart(points, QUANTITIES[measure], f"{anchor}-runs", "Run by run", caption)


def _ranked(row: pd.Series, tests: pd.DataFrame, measure: str) -> dict[str, Any]:
    """Return the row of a teacher, with its tests against each teacher of the reader."""
    told = []
    for _, test in tests[tests["second"] == row["teacher"]].iterrows():
        text = f"{Gap.of(test)}, {p_value(test['holm']).replace('p', 'Holm', 1)}"
        reason = test["reason"]
        told.append(f"{label(test['first'])}{f': not tested ({reason})' if reason else f' {text}'}")
    return {
        "name": row["teacher"],
        "source": row["source"],
        "n": row["n"],
        "mastered": plus_minus(row[f"{measure}_mean"], row[f"{measure}_std"]),
        "final": number(row[f"{FINAL}_mean"]),
        "missing": row["missing"],
        "tests": told,
    }


def write_comparison(
    sources: Sources,
    baselines: Sequence[str],
    output: Path | None = None,
    tell: Callable[[str], object] = lambda _: None,
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
    # So that no page replaces that of other baselines.
    name = "+".join(re.sub(r"[^\w.-]+", "_", str(name)).strip("_.") or "_" for name in baselines)
    folder = page_folder(source_list(sources)[0], output, "compare", "page") / name
    text, pictures = _render(read(sources), baselines, tell, measure)
    return write_page(folder, text, {f"{picture.name}.png": picture.png for picture in pictures})


def _render(
    frames: Frames, baselines: Sequence[str], tell: Callable[[str], object], measure: str
) -> tuple[str, list[Picture]]:
    mine, others, split = sides.named_jointly(
        sides.side_of(frames, "yours"), [sides.baseline_side(name) for name in baselines]
    )
    together = sides.frames_together(mine, others)
    runs, curves = (sides.together(mine, others, together, along=along) for along in (False, True))
    teachers = sides.new_teachers(mine)
    ranked = [rank for axis in dict.fromkeys((*AXES, measure)) for rank in ranks(runs, teachers, axis)]
    standings = [*sides.incomparable(mine, others, runs), *(rank.describe() for rank in ranked)]
    known = [frames, *(side.frames for side in others if side.frames is not None)]
    hours = pd.concat([each.run_hours for each in known])
    plans = plans_against_random(runs, teachers, hours[~hours.index.duplicated()], measure)
    for sentence in [*standings, *plans]:
        tell(sentence)
    tests = sides.duels(runs, teachers, measure)
    shown = leading(pooled(runs, [measure]), f"{measure}_mean", runs["teacher"], COMPARED)
    shown |= frozenset(teachers if len(teachers) <= SHOWN else ())
    verdicts, notes = root_verdicts(frames)
    quantity = QUANTITIES[measure]
    caption = "Marks are means over runs, lines their 95 % intervals, of results that may be compared."
    with shown_together(runs["teacher"]), own_first(teachers):
        found = list(places(runs, curves, tests, measure))
        chosen = pd.DataFrame([place.chosen_by for place in found])
        titles = [place.title for place in found]
        boards = _boards(ranked)
        pictures = list(_radars(runs[runs["teacher"].isin(shown)], others))
        text = page(
            "compare.html.j2",
            mine=mine,
            teachers=listed(map(label, teachers)),
            others=others,
            sentences=sentences(tests),
            missing=sides.missing(mine, teachers),
            places=found,
            overview=overview(found, titles, quantity, "All challenges", caption),
            controls=controls(chosen, runs["teacher"], curves["step"].dropna(), shown),
            beside=[(side, _beside_rows(sides.beside(mine, side))) for side in others],
            pictures=pictures,
            tables=list(_tables(runs)),
            standings=standings,
            ranks=[on_page(rank_chart(boards))] if boards else [],
            headlines=list(sentences_against_random(against_random(together, runs), teachers)),
            plans=plans,
            overall=overall_section(runs, measure),
            warnings=list(dict.fromkeys([*frames.notes, *split, *notes])),
            verdicts=decided(verdicts),
            quantity=quantity,
            head=MEASURES[measure].capitalize(),
            papers=QUANTITIES[PAPERS],
            how_tested=how_tested("all teachers that one of yours is set against on a challenge"),
        )
    return text, pictures


def _boards(ranked: Sequence[Rank]) -> dict[str, list[Rank]]:
    """Return the ranks of each level and budget on as many challenges, by axis, conditions and challenges."""
    found: dict[str, list[Rank]] = {}
    for rank in ranked:
        if rank.of > 1:
            level, steps = rank.across["expert_knowledge"], amount(rank.across["steps"])
            axis = AXES.get(rank.measure, MEASURES[rank.measure])
            where = f"{axis}, expert knowledge {level}, {steps} steps"
            which = f"{rank.of} teachers on {rank.challenges} challenges"
            found.setdefault(f"{where}: {which}", []).append(rank)
    return found


def _radars(runs: pd.DataFrame, others: Sequence[sides.Side]) -> Iterator[Picture]:
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


def _tables(runs: pd.DataFrame) -> Iterator[ResultTable]:
    for _, alike in runs.groupby(SETTINGS, dropna=False):
        for _, matrices, chosen in by_students(alike):
            both = pd.concat([pooled(chosen), pooled(chosen, by=["embodiment"])], ignore_index=True)
            yield from result_tables(TableResults(results_of(both), matrices))


def _radar(
    name: str, table: pd.DataFrame, tests: pd.DataFrame, title: str, caption: str
) -> Iterator[Picture]:
    try:
        figure = draw(radar(table, tests))
    except ValueError:  # no challenge of Stump Tracks, or no results yet
        return
    yield Picture.of(name, figure, title, caption)


def _beside_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    rows = table.assign(order=table["teacher"].map(teacher_order)).sort_values([*CHALLENGE_LEVEL, "order"])
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

"""Page that compares the reader's own results with baselines."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from analysis.baselines.catalogue import Sources, read, source_list
from analysis.charts.base import MASTERED, Chart
from analysis.charts.catalogue import points_of
from analysis.charts.curves import learning_curves
from analysis.charts.intervals import rank_chart, seeds_chart
from analysis.charts.page import on_page
from analysis.charts.paper import Picture, draw
from analysis.charts.radars import radar
from analysis.claims.judging import decided, root_verdicts
from analysis.comparisons import sources as result_sets
from analysis.comparisons.against_random import Gap, against_random, sentences_against_random
from analysis.comparisons.comparison import MOST_SHOWN, leading
from analysis.comparisons.pairwise import pairwise, pairwise_from_statistics
from analysis.comparisons.planning import plans_against_random
from analysis.comparisons.ranks import Rank, ranks
from analysis.comparisons.sentences import challenge_titles, sentences
from analysis.data.columns import CHALLENGE_LEVEL, COMPARED, SETTINGS
from analysis.data.frames import Frames, object_strings
from analysis.data.reference import PAPER
from analysis.formatting import listed, number, p_value, plus_minus, steps_text
from analysis.measures.evaluations import aggregate
from analysis.measures.pooling import by_students, parts_of, pooled
from analysis.measures.tested import AXES, FINAL, HEADLINE, MEASURES, PAPERS, QUANTITIES, how_tested
from analysis.names import label, own_first, teacher_order
from analysis.pages.page import controls, overall_section, page, page_folder, write_page
from analysis.pages.sections import Columns, Section, by_step, overview
from analysis.statistics import describe
from analysis.tables.paper_tables import TableResults, result_tables, results_of
from analysis.tables.table import ResultTable
from analysis.teacher_styles import shown_together


def challenge_sections(
    runs: pd.DataFrame, curves: pd.DataFrame, tests: pd.DataFrame, measure: str = HEADLINE
) -> Iterator[Section]:
    """Yield a section per challenge and level: the reader's results among comparable ones.

    Args:
        runs: runs from `sources.comparable_runs`, at their ends.
        curves: runs from `sources.comparable_runs`, at every evaluation.
        tests: tests from `sources.head_to_head`.
        measure: one of `tested.MEASURES`; learning curves are of each evaluation.
    """
    if runs.empty:
        return

    def texts(_step: int, _teacher: str, rows: Columns) -> dict[str, str]:
        values, final = describe(rows[measure]), describe(rows[FINAL])
        mastered = plus_minus(values.mean, values.std)
        return {"n": str(values.n), "mastered": mastered, "final": number(final.mean), "tests": ""}

    source_names = runs.groupby([*COMPARED, "teacher"], dropna=False)["source"].agg("first").reset_index()
    table = pooled(runs, list(dict.fromkeys([measure, FINAL])))
    table = table.merge(source_names, on=[*COMPARED, "teacher"])
    table = table.assign(title=challenge_titles(table))
    for count, (key, rows) in enumerate(table.groupby(COMPARED, dropna=False, sort=True), start=1):
        values: dict[str, Any] = dict(zip(COMPARED, key, strict=True))
        challenge_tests, ends, along = (_with_values(frame, values) for frame in (tests, runs, curves))
        ranked = rows.sort_values(f"{measure}_mean", ascending=False, na_position="last")
        along = along[along["step"].notna()].astype({"step": "int64"})
        points, anchor = points_of(along, ends, measure), f"place-{count}"
        points = points[points["value"].notna()]
        students = " and ".join(sorted({label(student) for _, student in parts_of(values["pool"])}))
        chosen_by = {name: str(values[name]) for name in ("environment", "challenge", "expert_knowledge")}
        yield Section(
            anchor=anchor,
            title=f"{rows['title'].iloc[0]}, {students}, expert knowledge {values['expert_knowledge']}",
            chosen_by=chosen_by | {"student": students},
            rows=[_ranked(row, challenge_tests, measure) for _, row in ranked.iterrows()],
            step_rows=by_step(
                along.loc[along[measure].notna(), list({"step", "teacher", measure, FINAL})], texts
            ),
            points=points,
            charts=list(map(on_page, _charts(anchor, points, along, measure))),
        )


def _with_values(table: pd.DataFrame, values: Mapping[str, Any]) -> pd.DataFrame:
    """Return the rows of `table` whose columns equal `values`, treating missing values as equal."""
    mask = np.ones(len(table), dtype=bool)
    for column, value in values.items():
        mask &= (table[column].isna() if pd.isna(value) else table[column] == value).to_numpy(bool)
    return table[mask]


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
    """Return a teacher's table row, with the tests of the reader's teachers against it."""
    texts = []
    for _, test in tests[tests["second"] == row["teacher"]].iterrows():
        text = f"{Gap.of(test)}, {p_value(test['holm']).replace('p', 'Holm', 1)}"
        reason = test["reason"]
        texts.append(f"{label(test['first'])}{f': not tested ({reason})' if reason else f' {text}'}")
    return {
        "name": row["teacher"],
        "source": row["source"],
        "n": row["n"],
        "mastered": plus_minus(row[f"{measure}_mean"], row[f"{measure}_std"]),
        "final": number(row[f"{FINAL}_mean"]),
        "missing": row["missing"],
        "tests": texts,
    }


@object_strings()
def write_comparison(
    sources: Sources,
    baselines: Sequence[str],
    output: Path | None = None,
    print_sentence: Callable[[str], object] = lambda _: None,
    measure: str = HEADLINE,
) -> Path:
    """Write a page that compares the results of a root with baselines, and return its ``index.html``.

    Args:
        sources: results of one's own, finished or not: one root or several.
        baselines: names of released baselines, folders or addresses of results.
        output: folder for pages, each in a folder named by its baselines; ``compare`` in the first of
            `sources` if that is a folder.
        print_sentence: function called with each of the first sentences of the page: results that cannot be
            compared, ranks over all challenges, and runs that would distinguish a teacher from Random.
        measure: one of `tested.MEASURES`, by which teachers are ranked and tested.

    Raises:
        ResultsRootError: if one of `sources` or a baseline is not a results root.
        ValueError: without a baseline, or for an object store without `output`.
    """
    if not baselines:
        raise ValueError(f"compare with what? Name a baseline, as in --baseline {PAPER}")
    # Each set of baselines has its own folder, so that no page replaces another.
    name = "+".join(re.sub(r"[^\w.-]+", "_", str(name)).strip("_.") or "_" for name in baselines)
    folder = page_folder(source_list(sources)[0], output, "compare", "page") / name
    text, pictures = _render(read(sources), baselines, print_sentence, measure)
    return write_page(folder, text, {f"{picture.name}.png": picture.png for picture in pictures})


def _render(
    frames: Frames, baseline_names: Sequence[str], print_sentence: Callable[[str], object], measure: str
) -> tuple[str, list[Picture]]:
    yours, baselines, split_names = result_sets.named_jointly(
        result_sets.result_set(frames, "yours"), list(map(result_sets.baseline_results, baseline_names))
    )
    joined = result_sets.joined_frames(yours, baselines)
    runs, curves = (
        result_sets.comparable_runs(yours, baselines, joined, along=along) for along in (False, True)
    )
    teachers = result_sets.new_teachers(yours)
    ranked = [rank for axis in dict.fromkeys((*AXES, measure)) for rank in ranks(runs, teachers, axis)]
    standings = [
        *result_sets.incomparable(yours, baselines, runs),
        *(rank.describe() for rank in ranked),
    ]
    all_frames = [frames, *(baseline.frames for baseline in baselines if baseline.frames is not None)]
    hours = pd.concat([root.run_hours for root in all_frames])
    plans = plans_against_random(runs, teachers, hours[~hours.index.duplicated()], measure)
    for sentence in [*standings, *plans]:
        print_sentence(sentence)
    tests = result_sets.head_to_head(runs, teachers, measure)
    shown = leading(pooled(runs, [measure]), f"{measure}_mean", runs["teacher"], COMPARED)
    shown |= frozenset(teachers if len(teachers) <= MOST_SHOWN else ())
    verdicts, notes = root_verdicts(frames)
    quantity = QUANTITIES[measure]
    caption = "Marks are means over runs, lines their 95 % intervals, of results that may be compared."
    with shown_together(runs["teacher"]), own_first(teachers):
        sections = list(challenge_sections(runs, curves, tests, measure))
        chosen = pd.DataFrame([section.chosen_by for section in sections])
        boards = _boards(ranked)
        pictures = list(_radars(runs[runs["teacher"].isin(shown)], baselines))
        text = page(
            "compare.html.j2",
            yours=yours,
            teachers=listed(map(label, teachers)),
            baselines=baselines,
            sentences=sentences(tests),
            missing=result_sets.missing_challenges(yours, teachers),
            sections=sections,
            overview=overview(
                sections, [section.title for section in sections], quantity, "All challenges", caption
            ),
            controls=controls(chosen, runs["teacher"], curves["step"].dropna(), shown),
            reference_only=[
                (baseline, _reference_rows(result_sets.reference_only(yours, baseline)))
                for baseline in baselines
            ],
            pictures=pictures,
            tables=list(_tables(runs)),
            standings=standings,
            ranks=[on_page(rank_chart(boards))] if boards else [],
            headlines=list(sentences_against_random(against_random(joined, runs), teachers)),
            plans=plans,
            overall=overall_section(runs, measure),
            warnings=list(dict.fromkeys([*frames.notes, *split_names, *notes])),
            verdicts=decided(verdicts),
            quantity=quantity,
            head=MEASURES[measure].capitalize(),
            papers=QUANTITIES[PAPERS],
            how_tested=how_tested("all teachers that one of yours is set against on a challenge"),
        )
    return text, pictures


def _boards(ranked: Sequence[Rank]) -> dict[str, list[Rank]]:
    """Group ranks by the title of their panel in `rank_chart`: measure, level, budget, challenges."""
    boards: dict[str, list[Rank]] = {}
    for rank in ranked:
        if rank.of > 1:
            level, steps = rank.across["expert_knowledge"], steps_text(rank.across["steps"])
            axis = AXES.get(rank.measure, MEASURES[rank.measure])
            where = f"{axis}, expert knowledge {level}, {steps} steps"
            which = f"{rank.of} teachers on {rank.challenges} challenges"
            boards.setdefault(f"{where}: {which}", []).append(rank)
    return boards


def _radars(runs: pd.DataFrame, baselines: Sequence[result_sets.ResultSet]) -> Iterator[Picture]:
    """Yield a radar chart for each set of settings of the results, and one for each published table."""
    students = runs["pool"].map(lambda pool: ", ".join(sorted({student for _, student in parts_of(pool)})))
    groups = runs.assign(students=students).groupby([*SETTINGS, "students"], dropna=False)
    for count, (_, group) in enumerate(groups, start=1):
        table, tests = pooled(group, [PAPERS]), pairwise(group, PAPERS, "random", detectable=False)
        caption = "Your results and what may be compared with them, as ratios of Random."
        yield from _radar(f"radar-{count}", table, tests, "Yours among comparable baselines", caption)
    for baseline in baselines:
        if baseline.runs is None:
            tests = pairwise_from_statistics(baseline.table, PAPERS, "random")
            caption = (
                f"The tables of {baseline.name} ({baseline.engine}), set beside: ratios of its own Random."
            )
            yield from _radar(f"radar-{baseline.name}", baseline.table, tests, baseline.name, caption)


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
    except ValueError:  # no results on challenges of Stump Tracks, or none yet
        return
    yield Picture.of(name, figure, title, caption)


def _reference_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
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

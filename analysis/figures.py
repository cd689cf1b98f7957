"""Figures for papers: one function each, data in, matplotlib figure out, and every figure that results allow.

`analysis.charts` computes what is drawn, and `analysis.style.save` writes figures to files.
"""

import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import pandas as pd
from matplotlib.figure import Figure

from analysis.charts import bars, curricula, curves, intervals, mastery, radars
from analysis.charts.bars import Whisker
from analysis.charts.curricula import Shot
from analysis.charts.curves import CurvePanel, body_panels, knowledge_panels
from analysis.charts.paper import animate, draw, figure_of
from analysis.charts.tasks import projected
from analysis.comparisons.boards import leaderboards
from analysis.comparisons.frame import pairwise, pairwise_from_statistics
from analysis.comparisons.measured import Measured, curricula_of, examples_of
from analysis.comparisons.verdicts import AXES
from analysis.data.columns import COMPARED, COMPARISON
from analysis.data.curricula import Axis, curriculum_of, task_axes
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE, is_baseline
from analysis.measures.evaluations import ceiling_percent, mastered_tasks
from analysis.measures.pooling import PLUS, by_conditions, pooled, result_runs
from analysis.measures.run_measures import evaluations_at, run_measures, training_returns_at
from analysis.names import short_labels, title

__all__ = [
    "CurvePanel",
    "Drawing",
    "Shot",
    "Whisker",
    "animation",
    "bars_with_pairs",
    "body_panels",
    "curriculum_strip",
    "curves_with_stars",
    "dimension_bands",
    "drawings",
    "film_strip",
    "knowledge_panels",
    "learning_curve",
    "mastery_map",
    "pairwise_curves",
    "projected",
    "published_drawings",
    "radar",
    "seeds_chart",
]

bars_with_pairs = figure_of(bars.bars_with_pairs)
curriculum_strip = figure_of(curricula.curriculum_strip)
curves_with_stars = figure_of(curves.curves_with_stars)
dimension_bands = figure_of(curricula.dimension_bands)
film_strip = figure_of(curricula.film_strip)
seeds_chart = figure_of(intervals.seeds_chart)
learning_curve = figure_of(curves.learning_curve)
mastery_map = figure_of(mastery.mastery_map)
pairwise_curves = figure_of(curves.pairwise_curves)
radar = figure_of(radars.radar)


def animation(
    shots: Sequence[Shot], plane: tuple[Axis, Axis], frames: int = 30, seconds: float = 6.0
) -> bytes:
    """Return a film strip in motion, as a GIF that repeats: a panel per run, drawn as in `film_strip`.

    Args:
        shots: runs as in `film_strip`; at most `curricula.MOST_SHOTS`.
        plane: the two task dimensions.
        frames: at most so many, and at most one for each step at which a teacher was probed.
        seconds: length of the whole; the last frame stays for another second.

    Raises:
        ValueError: too many frames or runs, or what `film_strip` raises.
    """
    return animate(curricula.film(shots, plane, frames), seconds)


MEASURE = "mastered_percent"

EARLY = 0.25
"""Share of the budget after which the radar is drawn once more (paper, sample efficiency)."""

NAMED = ("experiment", "embodiment", "student", "expert_knowledge")
"""Columns that name the files of a comparison, where they tell it from others."""

LONGEST_NAME = 16
"""Characters of a teacher's name beside the row of a film strip."""

STARS = 4
"""Rows of stars along a budget: every 5 of 20 million steps."""


@dataclass(frozen=True)
class Drawing:
    """A figure that is drawn on demand.

    Attributes:
        name: name of its files, without ending.
        draw: function that returns the figure, or a GIF.
    """

    name: str
    draw: Callable[[], Figure | bytes]


def published_drawings(table: pd.DataFrame) -> Iterator[Drawing]:
    """Yield the figures of published tables, in the columns of `reference.paper_frame`."""
    whole = table.groupby(["environment", "challenge"])["n"].transform("max") == table["n"]
    pools = table[whole]
    against, pairs = (pairwise_from_statistics(pools, MEASURE, name) for name in (BASELINE, None))
    yield Drawing("radar", partial(radar, pools, against))
    yield from _bars(pools, pairs)


def drawings(frames: Frames, measured: Measured) -> Iterator[Drawing]:
    """Yield the figures of a root: a set for each kind of results, the paper's or most of them first."""
    yield Drawing("ranks", partial(_ranks, frames))
    final = result_runs(frames, run_measures(frames))
    early = result_runs(frames, run_measures(frames, share=EARLY))
    for tag, mine in by_conditions(final):
        prefix = f"{tag}-" if tag else ""
        alike = early["run_id"].isin(mine["run_id"]) & (early["variant"] == mine["variant"].iloc[0])
        for drawing in _of_kind(frames, mine, early[alike]):
            yield Drawing(prefix + drawing.name, drawing.draw)
    comparisons = list(measured.comparisons)
    names = Counter(_name(comparison, NAMED) for comparison in comparisons)
    for comparison in comparisons:
        name = _name(comparison, NAMED)
        whole = name if names[name] == 1 else _name(comparison, COMPARISON)
        yield from _of_comparison(frames, comparison, whole)


def _name(comparison: Measured, columns: Sequence[str]) -> str:
    first = comparison.cells.iloc[0]
    return "-".join(re.sub(r"\W+", "_", str(first[column])) for column in columns if first[column])


def _of_kind(frames: Frames, final: pd.DataFrame, early: pd.DataFrame) -> Iterator[Drawing]:
    """Yield the figures of results under the same conditions, at their ends and `EARLY`."""
    for name, runs in (("radar", final), ("radar-early", early)):
        yield Drawing(name, partial(_radar, runs))
    yield from _bars(pooled(final, [MEASURE]), pairwise(final, MEASURE, detectable=False))
    budget = int(final["steps"].iloc[0])
    steps = [int(step) for step in sorted(frames.evaluations["step"].unique()) if step <= budget]
    values = evaluations_at(frames, steps).merge(training_returns_at(frames, steps), "left")
    along = final.drop(columns=[column for column in values if column != "run_id"], errors="ignore")
    along = along.merge(values, on="run_id")
    drawn = partial(_curves, budget // STARS)
    for number, (_, mine) in enumerate(along.groupby(COMPARED, dropna=False, sort=True), start=1):
        environment, challenge, level = mine[["environment", "challenge", "expert_knowledge"]].iloc[0]
        place = f"{environment}-{challenge}-{level}"
        several = any(PLUS in pool for pool in mine["pool"])
        panels = partial(
            body_panels if several else _panel, mine, ceiling=ceiling_percent(frames, environment)
        )
        yield Drawing(f"curves-{number:02}-{place}", partial(drawn, panels))
        yield Drawing(f"pairs-{number:02}-{place}", partial(_pairs, mine))
    for teacher, mine in along[along["environment"] == "stump_tracks"].groupby("teacher"):
        if mine["expert_knowledge"].nunique() > 1 and not is_baseline(str(teacher)):
            yield Drawing(f"knowledge-{teacher}", partial(drawn, partial(knowledge_panels, mine)))


def _ranks(frames: Frames) -> Figure:
    boards = leaderboards(frames)
    if not boards:
        raise ValueError("no run has been evaluated")
    ranked = {
        f"{AXES[axis].capitalize()}: {board.title}": sorted(
            (entry.ranks[axis] for entry in board.entries), key=lambda rank: -rank.mean
        )
        for board in boards
        for axis in AXES
    }
    return draw(intervals.rank_chart(ranked))


def _radar(runs: pd.DataFrame) -> Figure:
    return radar(pooled(runs, [MEASURE]), pairwise(runs, MEASURE, BASELINE, detectable=False))


def _bars(table: pd.DataFrame, tests: pd.DataFrame) -> Iterator[Drawing]:
    for environment in sorted(table["environment"].unique()):
        mine, theirs = (frame[frame["environment"] == environment] for frame in (table, tests))
        yield Drawing(f"bars-{environment}", partial(bars_with_pairs, mine, theirs))


def _panel(runs: pd.DataFrame, ceiling: float | None = None) -> list[CurvePanel]:
    tests = pairwise(runs, MEASURE, BASELINE, [*COMPARED, "step"], detectable=False)
    name = title("challenge", runs["challenge"].iloc[0])
    return [CurvePanel(name, pooled(runs, [MEASURE], ["step"]), tests, ceiling=ceiling)]


def _curves(every: int, panels: Callable[[], list[CurvePanel]]) -> Figure:
    return curves_with_stars(panels(), every)


def _pairs(runs: pd.DataFrame) -> Figure:
    tests = pairwise(runs, MEASURE, None, [*COMPARED, "step"], detectable=False)
    return pairwise_curves(pooled(runs, [MEASURE], ["step"]), tests)


def _of_comparison(frames: Frames, mine: Measured, name: str) -> Iterator[Drawing]:
    """Yield maps of mastered tasks, and curricula with the teachers' own state."""
    axes = task_axes(mine.cells)
    varied = [place for place, axis in enumerate(axes) if axis.low < axis.high]
    if len(mine.finals):
        plane = (axes[0], axes[1]) if len(axes) == 2 else None
        for test_set, shares in mastered_tasks(frames, mine.finals).groupby("test_set"):
            tasks = frames.test_tasks[frames.test_tasks["test_set"] == test_set]
            yield Drawing(f"{name}-mastery-{test_set}", partial(mastery_map, shares, tasks, plane))
    for first, second in itertools.combinations(varied[:3], 2):
        plane = (axes[first], axes[second])
        suffix = "" if len(axes) == 2 else f"-{axes[first].name}-{axes[second].name}".replace(" ", "_")
        dimensions = (first, second) if len(axes) > 2 else None
        for end, runs in _sheets(mine):
            for kind, drawn in (("film", film_strip), ("motion", animation)):
                film = partial(_film, drawn, frames, runs, dimensions, plane)
                yield Drawing(f"{name}-{kind}{suffix}{end}", film)
    if len(axes) == len(varied) == 2:
        for end, runs in _sheets(mine):
            drawn = partial(_training_tasks, frames, mine, runs, (axes[0], axes[1]))
            yield Drawing(f"{name}-training-tasks{end}", drawn)


def _sheets(mine: Measured) -> Iterator[tuple[str, dict[str, pd.Series]]]:
    """Yield the teachers' runs, sheet by sheet, each with a suffix for its name."""
    parts = curricula.sheets(list(examples_of(mine).items()))
    for number, part in enumerate(parts, start=1):
        yield f"-{number}" if len(parts) > 1 else "", dict(part)


def _training_tasks(
    frames: Frames, mine: Measured, runs: Mapping[str, pd.Series], plane: tuple[Axis, Axis]
) -> Figure:
    shown = curricula_of(frames, mine, runs)
    if not shown:
        raise ValueError("no run has played an episode")
    return curriculum_strip(shown, plane)


def _film(
    draw: Callable[..., Figure | bytes],
    frames: Frames,
    runs: Mapping[str, pd.Series],
    dimensions: tuple[int, int] | None,
    plane: tuple[Axis, Axis],
) -> Figure | bytes:
    shots, names = [], short_labels(runs, LONGEST_NAME)
    for teacher, run in runs.items():
        curriculum = curriculum_of(frames, run)
        if len(curriculum.probes):
            shown = projected(curriculum, dimensions) if dimensions else curriculum
            shots.append(Shot(names[teacher], teacher, shown))
    return draw(shots, plane)

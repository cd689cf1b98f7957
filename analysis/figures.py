"""Figures for papers, drawn by matplotlib: one function per figure, and all figures of a root.

`analysis.charts` makes the charts, and `analysis.style.save` writes figures to files.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import pandas as pd
from matplotlib.figure import Figure

from analysis.charts import bars, curricula, curves, intervals, mastery, radars
from analysis.charts.bars import Whisker
from analysis.charts.catalogue import PaperChart, paper_charts
from analysis.charts.curricula import Shot
from analysis.charts.curves import CurvePanel, body_panels, knowledge_panels
from analysis.charts.paper import animate, draw, figure_of
from analysis.charts.tasks import projected
from analysis.comparisons.comparison import Measurements, TeacherComparison
from analysis.comparisons.leaderboards import leaderboards
from analysis.comparisons.pairwise import pairwise, pairwise_from_statistics
from analysis.data.columns import CHALLENGE_LEVEL, COMPARED, COMPARISON
from analysis.data.curricula import Axis
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE, is_baseline
from analysis.measures.evaluations import ceiling_percent
from analysis.measures.pooling import PLUS, by_conditions, pooled, result_runs
from analysis.measures.run_measures import evaluations_at, run_measures, training_returns_at
from analysis.measures.tested import AXES
from analysis.names import title

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
    """Return an animated film strip as a looping GIF, with a panel per run as in `film_strip`.

    Args:
        shots: runs as in `film_strip`; at most `curricula.MOST_SHOTS`.
        plane: the two task dimensions.
        frames: largest number of frames, at most one for each step at which a teacher was probed.
        seconds: duration; the last frame stays for another second.

    Raises:
        ValueError: if there are too many frames or runs, or as in `film_strip`.
    """
    return animate(curricula.film(shots, plane, frames), seconds)


MEASURE = "mastered_percent"

EARLY = 0.25  # share of the budget after which a second radar shows sample efficiency, as in the paper

FILE_NAME = ("experiment", "embodiment", "student", "expert_knowledge")
"""Columns whose values name the files of a comparison, as long as these names are unique."""

STARS = 4  # number of stars per line over the budget: one every 5 million of 20 million steps


@dataclass(frozen=True)
class Drawing:
    """Figure for a paper: its file name, and the function that draws it."""

    name: str  # file name without suffix
    draw: Callable[[], Figure | bytes]  # function that returns the figure, or the content of a GIF


def published_drawings(table: pd.DataFrame) -> Iterator[Drawing]:
    """Yield the figures of published tables with the columns of `reference.paper_frame`."""
    whole = table.groupby(["environment", "challenge"])["n"].transform("max") == table["n"]
    pools = table[whole]
    against, pairs = (pairwise_from_statistics(pools, MEASURE, name) for name in (BASELINE, None))
    yield Drawing("radar", partial(radar, pools, against))
    yield from _bars(pools, pairs)


def drawings(measurements: Measurements) -> Iterator[Drawing]:
    """Yield the figures of a root: those of each set of conditions, then those of each comparison."""
    frames = measurements.frames
    yield Drawing("ranks", partial(_ranks, frames))
    final = result_runs(frames, run_measures(frames))
    early = result_runs(frames, run_measures(frames, share=EARLY))
    for tag, runs in by_conditions(final):
        prefix = f"{tag}-" if tag else ""
        alike = early["run_id"].isin(runs["run_id"]) & (early["variant"] == runs["variant"].iloc[0])
        for drawing in _under_conditions(frames, runs, early[alike]):
            yield Drawing(prefix + drawing.name, drawing.draw)
    comparisons = measurements.comparisons
    names = Counter(_file_name(comparison, FILE_NAME) for comparison in comparisons)
    for comparison in comparisons:
        name = _file_name(comparison, FILE_NAME)
        name = name if names[name] == 1 else _file_name(comparison, COMPARISON)
        for entry in paper_charts(comparison):
            yield Drawing(f"{name}-{entry.name}", partial(_drawn, entry))


def _file_name(comparison: TeacherComparison, columns: Sequence[str]) -> str:
    first = comparison.cells.iloc[0]
    return _joined(*(first[column] for column in columns if first[column]))


def _joined(*names: str) -> str:
    """Return names as a file name without punctuation, which some file systems do not allow."""
    return "-".join(re.sub(r"\W+", "_", name) for name in names)


def _drawn(entry: PaperChart) -> Figure | bytes:
    return animate(entry.chart()) if entry.animated else draw(entry.chart())


def _under_conditions(frames: Frames, final: pd.DataFrame, early: pd.DataFrame) -> Iterator[Drawing]:
    """Yield the figures of results under the same conditions: `final`, and `early` (after `EARLY`)."""
    for name, runs in (("radar", final), ("radar-early", early)):
        yield Drawing(name, partial(_radar, runs))
    yield from _bars(pooled(final, [MEASURE]), pairwise(final, MEASURE, detectable=False))
    budget = int(final["steps"].iloc[0])
    steps = [int(step) for step in sorted(frames.evaluations["step"].unique()) if step <= budget]
    values = evaluations_at(frames, steps).merge(training_returns_at(frames, steps), "left")
    along = final.drop(columns=[column for column in values if column != "run_id"], errors="ignore")
    along = along.merge(values, on="run_id")
    drawn = partial(_curves, budget // STARS)
    for number, (_, runs) in enumerate(along.groupby(COMPARED, dropna=False, sort=True), start=1):
        environment, challenge, level = runs[CHALLENGE_LEVEL].iloc[0]
        suffix = _joined(f"{number:02}", environment, challenge, level)
        several = any(PLUS in pool for pool in runs["pool"])
        panels = partial(
            body_panels if several else _panel, runs, ceiling=ceiling_percent(frames, environment)
        )
        yield Drawing(f"curves-{suffix}", partial(drawn, panels))
        yield Drawing(f"pairs-{suffix}", partial(_pairs, runs))
    for teacher, runs in along[along["environment"] == "stump_tracks"].groupby("teacher"):
        if runs["expert_knowledge"].nunique() > 1 and not is_baseline(str(teacher)):
            yield Drawing(_joined("knowledge", str(teacher)), partial(drawn, partial(knowledge_panels, runs)))


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
        parts = (frame[frame["environment"] == environment] for frame in (table, tests))
        yield Drawing(f"bars-{environment}", partial(bars_with_pairs, *parts))


def _panel(runs: pd.DataFrame, ceiling: float | None = None) -> list[CurvePanel]:
    tests = pairwise(runs, MEASURE, BASELINE, [*COMPARED, "step"], detectable=False)
    name = title("challenge", runs["challenge"].iloc[0])
    return [CurvePanel(name, pooled(runs, [MEASURE], ["step"]), tests, ceiling=ceiling)]


def _curves(every: int, panels: Callable[[], list[CurvePanel]]) -> Figure:
    return curves_with_stars(panels(), every)


def _pairs(runs: pd.DataFrame) -> Figure:
    tests = pairwise(runs, MEASURE, None, [*COMPARED, "step"], detectable=False)
    return pairwise_curves(pooled(runs, [MEASURE], ["step"]), tests)

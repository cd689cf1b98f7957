"""Analysis of results: measures, statistics, figures, and a one-page report.

Where to begin::

    import analysis

    frames = analysis.load("results")  # or the name of a release, as "lite-1"
    frames.cells, frames.evaluations  # pandas frames
    runs = analysis.runs_after(frames)  # a row per run, with all its measures
    analysis.pooled(runs)  # a row per teacher
    analysis.pairwise(runs, "mastered_percent")  # tests between all pairs

``docs/analysis.md`` has the columns. Modules that need matplotlib, scipy or jinja2, such as
`analysis.figures`, are imported on first use.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from analysis.comparisons.pairwise import pairwise, pairwise_from_statistics
from analysis.data.curricula import task_axes
from analysis.data.frames import Frames
from analysis.data.reference import paper_frame
from analysis.measures.curriculum_measures import curriculum_curves, curriculum_measures
from analysis.measures.evaluations import (
    aggregate,
    evaluation_curves,
    final_evaluations,
    mastered_tasks,
    training_curves,
)
from analysis.measures.pooling import pooled, result_runs, runs_after
from analysis.measures.run_measures import evaluations_at, run_measures
from analysis.tables.paper_tables import table_results
from tma_ray.support.lazy_imports import attach

if TYPE_CHECKING:
    from analysis import baselines, figures
    from analysis.baselines import find_baseline
    from analysis.charts.paper import style
    from analysis.comparisons.aggregates import interquartile_means
    from analysis.data.curricula import curriculum_of
    from analysis.tables.paper_tables import result_tables

__all__ = [
    "Frames",
    "aggregate",
    "baselines",
    "curriculum_curves",
    "curriculum_measures",
    "curriculum_of",
    "evaluation_curves",
    "evaluations_at",
    "figures",
    "final_evaluations",
    "find_baseline",
    "interquartile_means",
    "load",
    "mastered_tasks",
    "pairwise",
    "pairwise_from_statistics",
    "paper_frame",
    "pooled",
    "result_runs",
    "result_tables",
    "run_measures",
    "runs_after",
    "style",
    "table_results",
    "task_axes",
    "training_curves",
]

__getattr__, __dir__ = attach(__name__, __file__)


def load(root: str | Path) -> Frames:
    """Load a results root, finished or not, or a release as pandas frames.

    A missing table becomes an empty frame with a warning.

    Args:
        root: a folder, an ``s3://`` or ``gs://`` address, or the name of a release.

    Raises:
        ResultsRootError: if `root` is neither a results root nor a release.
        BaselineError: if a baseline is damaged, or has published means without runs.
    """
    from analysis.baselines.catalogue import read_source  # deferred: slow to import

    return read_source(root)

"""The panels of the paper's learning curves, from runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from analysis.comparisons.pairwise import pairwise
from analysis.data.reference import BASELINE
from analysis.figures.curves.stars import CurvePanel
from analysis.measures.pooling import COMPARED, pooled
from analysis.measures.variants import PLUS
from analysis.names import order, title
from tma_ray.tasks import KnowledgeLevel

MEASURES = {"mastered_percent": "Mastered test tasks (%)", "training_return": "Mean training return"}
"""What case studies show side by side, as their axes call it."""


def body_panels(
    runs: pd.DataFrame, measure: str = "mastered_percent", name: str = "Mastered test tasks (%)"
) -> list[CurvePanel]:
    """Returns a panel over all bodies of a pool, if it has several, and one for each, tested against Random.

    Args:
        runs: rows of `pooling.pool_runs` with the values of `run_measures.evaluations_at`, of one comparison,
            such as Parkour.
        measure: what is drawn.
        name: what that is, with its unit.

    Raises:
        ValueError: the runs are not of one comparison.
    """
    _one(runs, COMPARED)
    panels = []
    if runs["embodiment"].nunique() > 1 or any(PLUS in pool for pool in runs["pool"]):
        tests = pairwise(runs, measure, BASELINE, [*COMPARED, "step"], detectable=False)
        panels.append(CurvePanel("All bodies", pooled(runs, [measure], ["step"]), tests, measure, name))
    for body in sorted(runs["embodiment"].unique()):
        mine = runs[runs["embodiment"] == body]
        curves = pooled(mine, [measure], ["embodiment", "step"])
        tests = pairwise(mine, measure, BASELINE, [*COMPARED, "embodiment", "step"], detectable=False)
        panels.append(CurvePanel(title("embodiment", body), curves, tests, measure, name))
    return panels


def knowledge_panels(
    runs: pd.DataFrame,
    measures: Mapping[str, str] = MEASURES,
    reference: KnowledgeLevel | None = KnowledgeLevel.HIGH,
) -> list[CurvePanel]:
    """Returns a row of panels for each challenge, one for each measure, at all levels of expert knowledge.

    Args:
        runs: rows of `pooling.pool_runs` with the `measures` at each step, of the teachers to be shown.
        measures: columns of `runs`, with what their axes call them.
        reference: the level that the others are tested against; None for no tests.

    Raises:
        ValueError: the runs of a challenge differ in more than level and teacher.
    """
    within = [column for column in COMPARED if column != "expert_knowledge"]
    panels = []
    for challenge in sorted(runs["challenge"].unique(), key=lambda value: order("challenge", value)):
        mine = runs[runs["challenge"] == challenge]
        _one(mine, within)
        for measure, name in measures.items():
            tests, same = None, [*within, "teacher", "step"]
            if reference is not None:
                tests = pairwise(mine, measure, reference.value, same, "expert_knowledge", detectable=False)
            curves = pooled(mine, [measure], ["step"])
            panels.append(CurvePanel(title("challenge", challenge), curves, tests, measure, name))
    return panels


def _one(runs: pd.DataFrame, columns: Sequence[str]) -> None:
    mixed = [column for column in columns if runs[column].nunique(dropna=False) > 1]
    if mixed:
        raise ValueError(
            f"runs of several comparisons: expected one {', '.join(mixed)}; select the rows of one"
        )

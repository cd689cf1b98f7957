"""The panels of Parkour and of case studies, from runs and from a results root."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from synthetic_curves import MILLION, curve_runs
from synthetic_pools import parkour
from synthetic_results import SyntheticCampaign

from analysis.charts.paper.style import png
from analysis.data.frames import load
from analysis.figures import body_panels, curves_with_stars, knowledge_panels
from analysis.measures.pooling import pool_runs
from analysis.measures.run_measures import evaluations_at, training_returns_at

pytestmark = pytest.mark.slow


def parkour_runs() -> pd.DataFrame:
    bodies = ("classic_bipedal", "fish", "climbing_chimpanzee")
    means = {"random": (20, 10, 0), "alp_gmm": (60, 30, 1)}
    rows = [
        row
        for teacher, levels in means.items()
        for row in parkour(
            teacher,
            {body: [mean + seed for seed in range(4)] for body, mean in zip(bodies, levels, strict=True)},
            steps=10.0 * MILLION,
        )
    ]
    values = pd.concat(
        pd.DataFrame({"run_id": [row["run_id"] for row in rows], "step": step}).assign(
            mastered_percent=[row["mastered_percent"] * step / (10 * MILLION) for row in rows]
        )
        for step in (0, 5 * MILLION, 10 * MILLION)
    )
    cells = pd.DataFrame(rows).drop(columns=["mastered_percent", "step"])
    return pool_runs(cells, values)


def test_parkour_has_a_panel_for_all_bodies_and_one_for_each() -> None:
    panels = body_panels(parkour_runs())
    assert [panel.title for panel in panels] == [
        "All bodies",
        "Classic bipedal",
        "Climbing chimpanzee",
        "Fish",
    ]
    assert {int(panel.curves["n"].max()) for panel in panels[1:]} == {4}
    assert panels[0].curves["n"].max() == 12
    figure = curves_with_stars(panels)
    lines = {str(line.get_gid()): list(line.get_xdata()) for line in figure.axes[1].lines if line.get_gid()}
    assert lines == {"above-alp_gmm-low": [5 * MILLION, 10 * MILLION]}
    png(figure)


def test_case_studies_show_two_measures_side_by_side() -> None:
    runs = curve_runs(["alp_gmm"], every=5 * MILLION, head_start={"none": 0.0, "high": 0.3})
    mastered, returns = knowledge_panels(runs)
    assert (mastered.measure, returns.measure) == ("mastered_percent", "training_return")
    assert mastered.tests is not None
    assert set(mastered.tests["first"]) == {"none"}
    assert set(mastered.tests["second"]) == {"high"}
    assert len(curves_with_stars([mastered, returns]).axes) == 2
    assert all(panel.tests is None for panel in knowledge_panels(runs, reference=None))


def test_runs_of_several_comparisons_are_refused() -> None:
    runs = curve_runs(["adr"], seeds=2, every=5 * MILLION, head_start={"none": 0.0, "high": 0.3})
    with pytest.raises(ValueError, match="expected one expert_knowledge"):
        body_panels(runs)
    other = curve_runs(["adr"], seeds=2, every=5 * MILLION, mastery_threshold=100.0)
    with pytest.raises(ValueError, match="expected one mastery_threshold"):
        knowledge_panels(pd.concat([runs, other]))


def test_training_returns_are_the_latest_of_runs_that_got_there(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path)
    done, half = campaign.run("alp_gmm", 0), campaign.run("alp_gmm", 1, status="running", upto=0.5)
    frames = load(tmp_path)
    steps = [1_000_000, 2_000_000]
    found = training_returns_at(frames, steps).set_index(["step", "run_id"])["training_return"]
    assert set(found.index) == {(1_000_000, done), (1_000_000, half), (2_000_000, done)}
    values = training_returns_at(frames, steps).merge(evaluations_at(frames, steps), on=["step", "run_id"])
    panels = knowledge_panels(pool_runs(frames.cells, values))
    assert panels[1].curves["n"].tolist() == [2, 1]

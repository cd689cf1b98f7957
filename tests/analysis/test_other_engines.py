"""Runs of another engine stand beside ours; `test_conditions` has them in one root with ours."""

import json
from pathlib import Path

import pytest
from synthetic_results import BOX2D_RUN, SyntheticCampaign

from analysis import load
from analysis.baselines import Baseline
from analysis.baselines import release as pack
from analysis.comparisons.sources import (
    baseline_results,
    comparable_runs,
    head_to_head,
    reference_only,
    result_set,
)
from tma_ray.runs import RunSpec

pytestmark = pytest.mark.slow


@pytest.fixture
def box2d(tmp_path: Path) -> Path:
    """A root of runs in worlds of Box2D."""
    campaign = SyntheticCampaign(tmp_path / "box2d", steps=1000)
    for teacher, counts in (("random", [1, 1, 2]), ("riac", [4, 4, 5])):
        campaign.seeds(teacher, counts, **BOX2D_RUN)
    return campaign.root


def test_as_a_baseline_they_stand_beside_ours(box2d: Path, campaign: SyntheticCampaign) -> None:
    for teacher, counts in (("random", [2, 2, 3]), ("riac", [3, 3, 4])):
        campaign.seeds(teacher, counts)
    mine, theirs = result_set(load(campaign.root), "ours"), baseline_results(str(box2d))
    assert (mine.engine, theirs.engine) == ("Chipmunk, physics version 1", "Box2D")
    runs = comparable_runs(mine, [theirs])
    assert set(runs["source"]) == {"ours"}
    assert set(head_to_head(runs, ["riac"])["second"]) == {"random"}
    shown = reference_only(mine, theirs)
    assert shown["teacher"].tolist() == ["random", "riac"]
    assert all("engine: Box2D" in text for text in shown["differs"])


def test_a_release_of_them_says_whose_worlds_they_are(box2d: Path, tmp_path: Path) -> None:
    baseline = Baseline.open(pack(box2d, "theirs", tmp_path, "CC0-1.0"))
    assert (baseline.manifest.engine, baseline.manifest.physics_versions) == ("Box2D", ())
    assert "in worlds of Box2D" in (tmp_path / "theirs" / "README.md").read_text()


def test_a_run_of_another_engine_cannot_be_run_again(box2d: Path) -> None:
    spec = json.loads(load(box2d).cells["spec"].iloc[0])
    with pytest.raises(ValueError, match="Box2D simulated its worlds"):
        RunSpec.from_dict(spec)

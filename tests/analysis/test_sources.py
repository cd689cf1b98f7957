"""Several roots and baselines read as one: every view takes them, and Random serves wherever it was run."""

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from synthetic_results import BOX2D_RUN, SyntheticCampaign

from analysis.baselines import Baseline, BaselineError, release
from analysis.baselines import release as pack
from analysis.baselines.catalogue import read
from analysis.comparisons.comparison import Measurements
from analysis.comparisons.sentences import ranking
from analysis.comparisons.sources import (
    baseline_results,
    comparable_runs,
    head_to_head,
    reference_only,
    result_set,
)
from analysis.data.loading import load
from analysis.tables.paper_tables import table_results
from tma_ray.runs import RunSpec

STEPS = 1000


def write(root: Path, teacher: str, level: str, counts: list[int], experiment: str, **other: object) -> None:
    """Write finished runs that master so many of ten test tasks, one seed each."""
    campaign = SyntheticCampaign(root, steps=STEPS, experiment=experiment, campaign=experiment)
    campaign.seeds(teacher, counts, level=level, **other)


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Mine has a teacher at low and nothing else; theirs, a release, has Random at none."""
    folder = tmp_path_factory.mktemp("roots")
    write(folder / "mine", "frontier", "low", [7, 8, 7, 8], "frontier")
    write(folder / "runs", "random", "none", [2, 3, 2, 3], "original")
    return folder / "mine", Path(release(folder / "runs", "theirs", folder / "theirs"))


def test_random_serves_across_roots_and_levels(roots: tuple[Path, Path]) -> None:
    table = ranking(read(roots)).set_index(["expert_knowledge", "teacher"])
    assert set(table.index) == {("low", "frontier"), ("low", "random"), ("none", "random")}
    mine = table.loc[("low", "frontier")]
    assert (mine["n"], mine["difference"], mine["reason"]) == (4, 50, "")
    assert mine["holm"] < 0.001
    tests = Measurements(read(roots)).tests.set_index("measure").loc["mastered_percent"]
    assert (tests["experiment"], tests["difference"], tests["reason"]) == ("frontier", 50, "")
    mine, theirs = result_set(load(roots[0]), "mine"), baseline_results(str(roots[1]))
    runs = comparable_runs(mine, [theirs])
    assert set(runs["expert_knowledge"]) == {"low"}
    pairs = {("mine", "frontier"), ("theirs", "random")}
    assert set(zip(runs["source"], runs["teacher"], strict=True)) == pairs
    (duel,) = head_to_head(runs, ["frontier"]).to_dict("records")
    assert (duel["second"], duel["difference"], duel["reason"]) == ("random", 50, "")


def test_a_run_of_two_roots_is_read_once_where_it_got_furthest(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path / "begun", steps=STEPS)
    campaign.run("adr", 0, status="waiting")
    run = campaign.plain_run("adr", 1, {500: [0.0]}, status="running")
    write(tmp_path / "done", "adr", "low", [5, 6], "original")
    for roots in (("begun", "done"), ("done", "begun"), ("done", "done")):
        frames = read([tmp_path / name for name in roots])
        assert frames.cells["status"].tolist() == ["done", "done"]
        assert len(frames.evaluations) == 20
        assert ranking(frames, measure="mastered_percent")["mastered_percent_mean"].tolist() == [55]
    assert frames.results_of(run).find(run).status == "done"


def test_what_is_one_name_in_two_roots_and_two_things_is_split(tmp_path: Path) -> None:
    spec: dict[str, Any] = {"algorithm_versions": {"teacher": 1}, "teacher": "adr", "task_space": []}
    for name, version in (("one", 1), ("two", 2)):
        spec["algorithm_versions"] = {"teacher": version}
        text = json.dumps({"seed": 0, "student": "sac"} | spec)
        write(tmp_path / name, "adr", "low", [5], name, spec=text)
    frames = read([tmp_path / "one", tmp_path / "two"])
    assert frames.cells["teacher"].nunique() == 2
    assert any("stand apart as" in note for note in frames.notes)


@pytest.mark.slow
def test_joined_roots_are_the_same_as_one_root(tmp_path: Path) -> None:
    write(tmp_path / "a", "random", "low", [2, 3, 2], "original")
    write(tmp_path / "b", "adr", "low", [7, 8, 7], "original")
    for teacher, counts in (("random", [2, 3, 2]), ("adr", [7, 8, 7])):
        write(tmp_path / "both", teacher, "low", counts, "original")
    frames, whole = read([tmp_path / "a", tmp_path / "b"]), load(tmp_path / "both")
    pd.testing.assert_frame_equal(ranking(frames), ranking(whole))
    (mine,), (theirs,) = table_results(frames), table_results(whole)
    pd.testing.assert_frame_equal(mine.rows, theirs.rows)
    run_ids = whole.cells["run_id"].tolist()
    assert len(frames.episode_returns(run_ids)) == len(whole.episode_returns(run_ids))


SLOWER = [pytest.param(name, marks=pytest.mark.slow) for name in ("claims", "tables", "report", "figures")]


@pytest.mark.parametrize("command", ["ranking", *SLOWER])
def test_every_command_takes_several_roots_and_baselines(command, roots, tmp_path, monkeypatch, told):
    mine, theirs = roots
    monkeypatch.setenv("TMA_BASELINES", str(theirs))
    output = [] if command in ("ranking", "claims") else ["--output", tmp_path]
    only = ["--only", "bars"] if command == "figures" else []
    by_name = told(0, command, mine, "--baseline", "theirs", *output, *only)
    assert told(0, command, mine, theirs, *output, *only) == by_name


def test_published_means_have_no_runs_to_pool(roots: tuple[Path, Path]) -> None:
    with pytest.raises(BaselineError, match="tma-ray compare"):
        read([roots[0], "paper-2021"])
    with pytest.raises(ValueError, match="at least one results root"):
        read([])


@pytest.mark.parametrize("command", ["ranking {}", "report {}", "compare lite-1 --baseline {}", "verify {}"])
def test_a_misspelt_name_gets_the_nearest_one(command, tmp_path, monkeypatch, told):
    monkeypatch.chdir(tmp_path)
    said = told(2, *command.format("paper-2020").split())
    assert "'paper-2020' is not a results root, nor the name of a baseline: did you mean 'paper-2021'" in said
    assert not any(tmp_path.iterdir())


@pytest.fixture
def box2d(tmp_path: Path) -> Path:
    campaign = SyntheticCampaign(tmp_path / "box2d", steps=1000)
    for teacher, counts in (("random", [1, 1, 2]), ("riac", [4, 4, 5])):
        campaign.seeds(teacher, counts, **BOX2D_RUN)
    return campaign.root


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_release_of_them_says_whose_worlds_they_are(box2d: Path, tmp_path: Path) -> None:
    baseline = Baseline.open(pack(box2d, "theirs", tmp_path, "CC0-1.0"))
    assert (baseline.manifest.engine, baseline.manifest.physics_versions) == ("Box2D", ())
    assert "in worlds of Box2D" in (tmp_path / "theirs" / "README.md").read_text()


@pytest.mark.slow
def test_a_run_of_another_engine_cannot_be_run_again(box2d: Path) -> None:
    spec = json.loads(load(box2d).cells["spec"].iloc[0])
    with pytest.raises(ValueError, match="Box2D simulated its worlds"):
        RunSpec.from_dict(spec)

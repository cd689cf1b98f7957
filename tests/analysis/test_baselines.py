"""Baselines: the paper's, and releases that hold what their root held, no more and no less."""

import json
import os
import shutil
import warnings
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq
import pytest
from synthetic_results import SMALL, SyntheticCampaign
from views import Told, printed

from analysis.baselines import (
    BaselineError,
    add_to_release,
    as_baseline,
    baselines,
    find_baseline,
    newest_release,
    release,
    verify,
)
from analysis.baselines.catalogue import BASELINE_FILE, BASELINES_VARIABLE, BaselineKind
from analysis.commands.paper import write_tables
from analysis.commands.releases import show_baselines
from analysis.data.frames import Frames
from analysis.data.loading import load
from analysis.data.reference import paper_frame
from tma_ray.results import Lease, ResultsRootError, Store, Table, compact

TEACHERS = ("random", "alp_gmm", "<b>|mine")

OLD_RELEASE = Path(__file__).parents[1] / "compatibility" / "version_1" / "release"
"""Release whose table of runs has no column ``mastery_threshold``."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished campaign of three teachers with two seeds, two experiments sharing one run."""
    folder = tmp_path_factory.mktemp("campaign") / "root"
    campaign = SyntheticCampaign(folder, boxes=True, **SMALL)
    for teacher in TEACHERS:
        for seed in range(2):
            run_id = campaign.run(teacher, seed)
            policy = folder / "policies" / run_id
            policy.mkdir(parents=True)
            (policy / "policy.json").write_text("{}")
            (policy / "policy.safetensors").write_bytes(bytes(8))
    again = SyntheticCampaign(folder, experiment="again", campaign="second", **SMALL)
    again.cell(again.record("random", 0, "low", run_id="original-random-low-0"), "low")
    return folder


@pytest.fixture(scope="module")
def released(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return release(root, "mine-1.0", tmp_path_factory.mktemp("releases"), "CC-BY-4.0")


def assert_same(found: Frames, expected: Frames) -> None:
    for field in fields(Frames):
        ours, theirs = getattr(found, field.name), getattr(expected, field.name)
        if isinstance(ours, pd.DataFrame):
            pd.testing.assert_frame_equal(ours, theirs, check_exact=True)
    assert found.warnings == expected.warnings
    for table in Table:
        assert found.results.table(table).equals(expected.results.table(table)), table
    for run_id in expected.cells["run_id"].unique():
        for name in ("episodes", "curriculum"):
            ours, theirs = getattr(found, name)(run_id), getattr(expected, name)(run_id)
            assert len(theirs)
            pd.testing.assert_frame_equal(ours, theirs, check_exact=True)
        logs = [frames.results.table(Table.TEACHER_LOG, [run_id]) for frames in (found, expected)]
        assert logs[0].equals(logs[1])


def test_a_release_loads_as_its_root_does(root: Path, released: Path) -> None:
    assert_same(load(released), load(root))
    assert_same(find_baseline(released).frames(), load(root))
    assert write_tables(released).text == write_tables(root).text


def described(baseline: Path) -> Any:
    """Return the data set of a baseline's Croissant metadata, without errors or warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import mlcroissant

        found = mlcroissant.Dataset(baseline / "croissant.json")
    assert not found.metadata.ctx.issues.errors
    assert not found.metadata.ctx.issues.warnings
    return found


@pytest.mark.slow
def test_its_croissant_metadata_are_valid_and_lead_to_its_rows(released: Path) -> None:
    found = described(released)
    assert {each.uuid for each in found.metadata.record_sets} == {str(table) for table in Table}
    returns = load(released).results.table(Table.EVALUATIONS).column("episodic_return").to_pylist()
    rows = list(found.records("evaluations"))
    assert sorted(row["evaluations/episodic_return"] for row in rows) == sorted(returns)


@pytest.mark.slow
def test_columns_that_older_files_of_a_release_lack_are_not_in_its_metadata(
    root: Path, tmp_path: Path
) -> None:
    old = Path(shutil.copytree(OLD_RELEASE, tmp_path / "old"))
    add_to_release(root, "old", "new", tmp_path)
    found = described(old)
    assert len(list(found.records("runs"))) == len(load(old).results.runs())
    files = [pq.read_schema(path).names for path in (old / "tables/runs").glob("*.parquet")]
    assert len(set(map(tuple, files))) > 1


@pytest.mark.slow
def test_releases_that_ship_have_valid_croissant_metadata() -> None:
    with_runs = [each for each in baselines() if each.manifest.kind is BaselineKind.RUNS]
    assert with_runs
    for each in with_runs:
        found = described(Path(each.location))
        assert found.metadata.name == each.manifest.name
        assert len(list(found.records("runs"))) == each.manifest.holds["runs"]


def test_a_release_has_one_file_per_table_and_experiment_and_nothing_that_runs(released: Path) -> None:
    files = sorted(path.relative_to(released).as_posix() for path in released.rglob("*") if path.is_file())
    episodes = [name for name in files if "/episodes/" in name]
    assert episodes == [f"tables/episodes/{name}.parquet" for name in ("again", "original")]
    assert {Path(name).suffix for name in files} == {".gz", ".json", ".md", ".parquet", ".safetensors"}
    assert sum(name.endswith(".safetensors") for name in files) == 6
    assert not [name for name in files if name.startswith(("staging", "checkpoints", "tmp", "lease"))]


def test_the_manifest_and_the_card_say_what_it_holds(released: Path) -> None:
    manifest = find_baseline(released).manifest
    assert manifest.holds["teachers"] == sorted(TEACHERS)
    assert manifest.holds["seeds"] == [0, 1]
    assert manifest.holds["steps"] == [40_000]
    assert (manifest.holds["runs"], manifest.holds["policies"], manifest.holds["evaluations"]) == (6, 6, 30)
    assert (manifest.engine, manifest.physics_versions, manifest.partial) == ("Chipmunk", (1,), "")
    card = (released / "README.md").read_text(encoding="utf-8")
    for words in ("# mine-1.0", "CC-BY-4.0", "ALP-GMM", "| seeds | 0 to 1 |", "The final policies are in"):
        assert words in card
    assert "Stump Tracks, original task space" in card
    assert "<b>" not in card
    assert "part of its campaigns" not in card


def test_a_whole_release_is_verified_and_damage_is_named(released: Path, tmp_path: Path, told: Told) -> None:
    assert verify(released).whole
    copy = Path(shutil.copytree(released, tmp_path / "copy"))
    training = copy / "tables/training/original.parquet"
    content = bytearray(training.read_bytes())
    content[len(content) // 2] ^= 1
    training.write_bytes(bytes(content))
    (copy / "policies/original-random-low-0/policy.json").unlink()
    (copy / "policies/original-random-low-1/policy.pkl").write_bytes(b"danger")
    assert told(1, "baselines", "verify", copy).splitlines() == [
        "policies/original-random-low-1/policy.pkl: it is not of this baseline",
        "policies/original-random-low-0/policy.json: it is missing",
        "tables/training/original.parquet: its sha256 is not the recorded one",
    ]
    manifest = json.loads((copy / "baseline.json").read_text())
    manifest["files"][0]["path"] = "../secret"
    (copy / "baseline.json").write_text(json.dumps(manifest))
    with pytest.raises(BaselineError, match="may lead out of its folder"):
        verify(copy)


def test_a_campaign_that_is_not_done_is_released_only_as_a_part(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path / "root", steps=1_000)
    campaign.plain_run("random", 0, {0: [0.0], 1_000: [300.0]})
    campaign.plain_run("random", 1, {0: [0.0]}, status="running")
    campaign.plain_run("adr", 0, {0: [0.0]}, status="failed")
    campaign.run("adr", 1, "waiting")
    root, output = tmp_path / "root", tmp_path / "releases"
    with pytest.raises(BaselineError, match=r"1 of 4 runs are done, 1 running, .*: finish the campaign"):
        release(root, "half", output)
    assert not output.exists()
    folder = release(root, "half", output, partial=True)
    found, expected = load(folder), load(root)
    for name in ("cells", "attempts", "evaluations", "training", "test_tasks"):
        pd.testing.assert_frame_equal(getattr(found, name), getattr(expected, name), check_exact=True)
    assert verify(folder).whole
    assert find_baseline(folder).manifest.partial == "1 of 4 runs are done, 1 running, 1 failed, 1 waiting"
    card = (folder / "README.md").read_text(encoding="utf-8")
    assert "part of its campaigns only:** 1 of 4 runs are done, 1 running, 1 failed, 1 waiting" in card
    assert "None was given" in card


@pytest.mark.parametrize("name", ["", ".hidden", "a/b", "..", "a b"])
def test_a_name_that_is_no_folders_is_refused(root: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(BaselineError, match="use letters, digits"):
        release(root, name, tmp_path)


def test_nothing_is_overwritten_and_nothing_is_left_of_a_failure(root, released, tmp_path, monkeypatch):
    with pytest.raises(BaselineError, match="never overwritten"):
        release(root, released.name, released.parent)
    with pytest.raises(ResultsRootError, match="a results root"):
        release(tmp_path / "nowhere", "mine", tmp_path / "out")
    monkeypatch.setattr("analysis.baselines.releasing.table_results", lambda frames: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        release(root, "mine", tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


def test_a_root_at_work_is_not_released(root: Path, tmp_path: Path) -> None:
    at_work = pytest.raises(BaselineError, match="stumps is at work on the root")
    with Lease(Store.open(root), "stumps"), at_work:
        release(root, "mine", tmp_path, partial=True)
    assert not list(tmp_path.iterdir())


def test_an_empty_root_is_nothing_to_release(tmp_path: Path) -> None:
    SyntheticCampaign(tmp_path / "root")
    with pytest.raises(BaselineError, match="nothing to release"):
        release(tmp_path / "root", "mine", tmp_path)


@pytest.mark.slow
def test_a_root_with_merged_files_makes_the_same_release(root: Path, released: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(root, tmp_path / "root")
    compact(copy)
    assert_same(load(copy), load(root))
    again = release(copy, "again", tmp_path)
    names = {path.relative_to(again) for path in again.glob("tables/*/*")}
    for name in names:
        assert (again / name).read_bytes() == (released / name).read_bytes()
    assert names == {path.relative_to(released) for path in released.glob("tables/*/*")}


def test_the_papers_tables_are_a_baseline() -> None:
    paper = find_baseline("paper-2021")
    pd.testing.assert_frame_equal(paper.published(), paper_frame(), check_exact=True)
    assert verify("paper-2021").whole
    assert paper.manifest.engine == "Box2D"
    assert (paper.published()["doubt"] != "").sum() == 3
    with pytest.raises(BaselineError, match="no runs"):
        paper.frames()
    assert as_baseline("paper-2021") == paper


def test_baselines_are_found_by_name(released: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = [each.manifest.name for each in baselines()]
    assert {"lite-1", "paper-2021"} <= set(shipped)
    with pytest.raises(BaselineError, match=rf"no baseline 'mine-1.0': known: {', '.join(shipped)}"):
        find_baseline("mine-1.0")
    monkeypatch.setenv(BASELINES_VARIABLE, str(released.parent))
    assert [each.manifest.name for each in baselines()] == sorted(["mine-1.0", *shipped])
    assert find_baseline("mine-1.0").location == str(released)
    assert len(find_baseline("mine-1.0").frames().cells) == 7
    text = printed(show_baselines, width=300)
    assert "CC-BY-4.0" in text
    assert "Box2D" in text
    monkeypatch.setenv(BASELINES_VARIABLE, os.pathsep.join([str(released), str(tmp_path)]))
    with pytest.raises(BaselineError, match="where no baseline lies"):
        baselines()


@pytest.mark.parametrize(
    ("gaps", "whole"),
    [
        ({}, True),
        ({"partial": "1 of 4 runs are done, 3 waiting", "core": ()}, False),
        ({"partial": "core has 69 of 70 runs", "done": {"core": 69}}, False),
        ({"partial": "later has 0 of 56 runs", "done": {"core": 70, "later": 0}}, True),
        ({"holds": {"steps": [2_000_000, 6_000_000]}}, True),
        ({"holds": {"steps": [20_000_000]}}, False),
    ],
)
def test_the_newest_release_has_a_whole_core_and_budgets_of_tier_lite(gaps, whole, tmp_path, monkeypatch):
    manifest = replace(find_baseline("lite-1").manifest, name="later-1", created="2999-01-01")
    manifest = replace(manifest, core=("core",), planned={"core": 70, "later": 56})
    monkeypatch.setenv(BASELINES_VARIABLE, str(tmp_path))
    (tmp_path / BASELINE_FILE).write_bytes(replace(manifest, **gaps).to_bytes())
    assert (newest_release().manifest.name == "later-1") is whole


def test_two_baselines_of_one_name_are_told_apart_by_their_places(root, released, tmp_path, monkeypatch):
    other = Path(shutil.copytree(released, tmp_path / "other"))
    monkeypatch.setenv(BASELINES_VARIABLE, os.pathsep.join([str(released), str(other)]))
    with pytest.raises(BaselineError, match="2 baselines are called"):
        find_baseline("mine-1.0")
    assert find_baseline(other).location == str(other)


def test_a_results_root_is_no_baseline(root: Path) -> None:
    assert as_baseline(root) is None
    with pytest.raises(BaselineError, match=r"baseline\.json is missing"):
        verify(root)


@pytest.mark.slow
def test_a_release_in_a_bucket_is_found_verified_and_loads_the_same(root, released, s3_root, monkeypatch):
    source, target = Store.open(released), Store.open(f"{s3_root}/mine-1.0")
    for path in source.files():
        target.write_bytes(path, source.read_bytes(path))
    monkeypatch.setenv(BASELINES_VARIABLE, s3_root)
    found = find_baseline("mine-1.0")
    assert found.location == f"{s3_root}/mine-1.0"
    assert verify("mine-1.0").whole
    assert_same(found.frames(), load(root))

"""Releases that grow by shards: each adds what is new, changes nothing else, and a batch starts from them."""

import json
import shutil
from pathlib import Path

import gymnasium
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml
from synthetic_results import SMALL, SyntheticCampaign
from views import Told

from analysis.baselines import (
    About,
    BaselineError,
    add_to_release,
    find_baseline,
    median_policies,
    release,
    verify,
)
from analysis.baselines.catalogue import BASELINES_VARIABLE
from analysis.data.loading import load
from analysis.measures.run_measures import run_measures
from tma_ray.results import LEAN, Committer, Results, ResultsRootError, Store, Table, start_from
from tma_ray.students import load_policy, make_student
from tma_ray.tasks import MASTERY_RETURN

PACKED = ("runs", "attempts", "cells", "evaluations", "training", "curriculum")


def batch(folder: Path, seeds: range, campaign: str = "batch") -> Path:
    """A root with one run of each of two teachers and each seed."""
    runs = SyntheticCampaign(folder, campaign=campaign, boxes=True, **SMALL)
    for teacher in ("random", "alp_gmm"):
        for seed in seeds:
            runs.run(teacher, seed)
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return batch(tmp_path_factory.mktemp("first") / "first", range(2))


@pytest.fixture(scope="module")
def whole(first: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    about = About(core=("batch",), gaps="The campaign `more` has not begun.")
    return add_to_release(first, "growing", "batch-1", tmp_path_factory.mktemp("out"), "CC0-1.0", about=about)


@pytest.fixture
def grown(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "out" / "growing"))


@pytest.fixture(scope="module")
def more(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return batch(tmp_path_factory.mktemp("more") / "more", range(2, 3))


def test_a_shard_is_a_file_per_table_without_episodes_policies_and_hosts(first: Path, grown: Path) -> None:
    tables = {name for name in files(grown) if name.startswith("tables/")}
    assert tables == {f"tables/{table}/batch-1.parquet" for table in PACKED}
    assert verify(grown).whole
    hosts = load(first).attempts["host"].astype(str)
    assert (hosts != "").all()
    for content in files(grown).values():
        assert not any(host.encode() in content for host in hosts.unique())
    assert set(load(grown).attempts["host"].astype(str)) <= {""}


def test_what_it_holds_of_its_runs_is_what_their_root_holds(first: Path, grown: Path) -> None:
    ours, theirs = load(grown), load(first)
    for name in ("cells", "training", "test_tasks"):
        pd.testing.assert_frame_equal(getattr(ours, name), getattr(theirs, name), check_exact=True)
    returns = theirs.evaluations["episodic_return"].astype(np.float32).astype(float)
    evaluations = theirs.evaluations.assign(episodic_return=returns)
    pd.testing.assert_frame_equal(ours.evaluations, evaluations, check_exact=True)
    tasks = [frames.results.table(Table.CURRICULUM)["task"].to_numpy() for frames in (ours, theirs)]
    probes, exact = map(np.stack, tasks)
    assert len(probes) > 100
    assert not np.array_equal(probes, exact)
    np.testing.assert_allclose(probes, exact, rtol=2.0**-12, atol=0)
    assert ours.results.table(Table.EPISODES).num_rows == 0
    manifest = find_baseline(grown).manifest
    told = (manifest.licence, manifest.core, manifest.planned, manifest.partial)
    assert told == ("CC0-1.0", ("batch",), {"batch": 4}, "")
    card = (grown / "README.md").read_text()
    assert "It holds no policies" in card
    assert "The final policies are in" not in card
    assert "## Known gaps\n\nThe campaign `more` has not begun.\n" in card


def test_the_card_has_a_configuration_for_each_table_that_has_rows(grown: Path) -> None:
    """A library that loads data sets, such as the hub's, would show one table for all."""
    _, matter, text = (grown / "README.md").read_text().split("---\n", 2)
    assert text.startswith("\n# growing\n")
    configurations = {each["config_name"]: each["data_files"] for each in yaml.safe_load(matter)["configs"]}
    files = [path for path in grown.glob("tables/*/*.parquet") if pq.read_metadata(path).num_rows]
    assert configurations.keys() == {path.parent.name for path in files}
    assert {path for each in configurations.values() for path in grown.glob(each)} >= {*files}


@pytest.mark.parametrize("name", ["lite-1", "lite-2"])
def test_the_cards_that_ship_have_configurations(name: str) -> None:
    folder = Path(find_baseline(name).location)
    _, matter, _ = (folder / "README.md").read_text().split("---\n", 2)
    configurations = [each["config_name"] for each in yaml.safe_load(matter)["configs"]]
    assert configurations == sorted(path.name for path in (folder / "tables").iterdir())


@pytest.mark.parametrize("threshold", [0.0, 0.1, 0.7, MASTERY_RETURN])
def test_no_rounded_return_crosses_the_threshold_of_mastery(threshold: float, tmp_path: Path) -> None:
    near = [threshold, np.nextafter(threshold, np.inf), np.nextafter(threshold, -np.inf)]
    returns = [*near, threshold + 1 / 3, threshold - 1 / 3, np.inf, -np.inf, np.nan]
    root = SyntheticCampaign(tmp_path / "root")
    spec = {} if threshold == MASTERY_RETURN else {"mastery_threshold": threshold}
    root.plain_run("random", 0, {root.steps: returns}, spec=json.dumps(spec))
    before = load(root.root).evaluations
    after = load(release(root.root, "lean", tmp_path, contents=LEAN)).evaluations
    assert before["mastered"].tolist() == [False, True, False, True, False, True, False, False]
    assert after["mastered"].tolist() == before["mastered"].tolist()
    np.testing.assert_allclose(after["episodic_return"], returns, rtol=2.0**-24)
    assert after["episodic_return"][3] == np.float32(returns[3])


@pytest.mark.parametrize(("probes", "kept"), [(9, 9), (20, 20), (21, 11), (81, 17)])
def test_a_lean_release_has_at_most_twenty_probes_of_a_curriculum(
    probes: int, kept: int, tmp_path: Path
) -> None:
    campaign = SyntheticCampaign(tmp_path / "root", steps=10 * (probes - 1), evaluation_every=10)
    campaign.updates = probes - 1
    run_id = campaign.run("random", 0)
    before = load(tmp_path / "root").curriculum(run_id)
    place = release(tmp_path / "root", "lean", tmp_path, contents=LEAN)
    after = load(place).curriculum(run_id)
    steps, (gap,) = sorted(after["step"].unique()), set(np.diff(sorted(after["step"].unique())))
    assert (before["step"].nunique(), len(steps), steps[-1]) == (probes, kept, before["step"].max())
    same = before[before["step"].isin(steps)].reset_index(drop=True)
    assert after[["step", "sample"]].equals(same[["step", "sample"]])
    np.testing.assert_allclose(np.stack(after["task"]), np.stack(same["task"]), rtol=2.0**-12)
    assert gap % 10 == 0
    assert verify(place).whole


def test_a_second_shard_adds_what_is_new_and_changes_no_file(grown: Path, tmp_path: Path) -> None:
    root = tmp_path / "second"
    assert start_from(Store.open(root), Store.open(grown)) == 4
    batch(root, range(2, 3), campaign="more")
    before = files(grown)
    assert add_to_release(root, "growing", "batch-2", grown.parent) == grown
    after = files(grown)
    changed = {name for name in before if after[name] != before[name]}
    assert changed == {"README.md", "baseline.json", "manifests.jsonl.gz", "croissant.json"}
    assert set(after) - set(before) == {f"tables/{table}/batch-2.parquet" for table in PACKED}
    assert verify(grown).whole
    assert sorted(load(grown).cells["seed"]) == [0, 0, 1, 1, 2, 2]
    manifest = find_baseline(grown).manifest
    assert (manifest.core, manifest.planned) == (("batch",), {"batch": 4, "more": 2})
    assert manifest.done == manifest.planned
    assert manifest.gaps == "The campaign `more` has not begun."


def test_runs_of_a_release_are_done_in_a_root_that_starts_from_it(grown: Path, tmp_path: Path) -> None:
    root = Store.open(tmp_path / "next")
    start_from(root, Store.open(grown))
    ids = [manifest.run.run_id for manifest in Results.open(grown).runs()]
    assert Committer(root).done([*ids, "ppo_random-s9-0123456789ab"]) == set(ids)
    assert start_from(root, Store.open(grown)) == 0
    assert not root.exists("baseline.json")


def test_nothing_new_and_names_twice_are_refused(first: Path, grown: Path, more: Path) -> None:
    before = files(grown)
    with pytest.raises(BaselineError, match="nothing to add"):
        add_to_release(first, "growing", "batch-2", grown.parent)
    with pytest.raises(ResultsRootError, match="exists"):
        add_to_release(more, "growing", "batch-1", grown.parent)
    with pytest.raises(ValueError, match="letters, digits"):
        add_to_release(more, "growing", "../x", grown.parent)
    assert files(grown) == before
    assert sorted(path.name for path in grown.parent.iterdir()) == ["growing"]


def test_a_release_that_would_lose_files_of_others_does_not_grow(grown: Path, more: Path) -> None:
    (grown / ".git").mkdir()
    for name in ("notes.txt", ".git/config"):
        (grown / name).write_text("mine")
        before = files(grown)
        with pytest.raises(BaselineError, match=rf"{name} is not of the release.*move it first"):
            add_to_release(more, "growing", "batch-2", grown.parent)
        assert files(grown) == before
        (grown / name).unlink()
    (grown / "tables/.DS_Store").write_text("mine")
    add_to_release(more, "growing", "batch-2", grown.parent)
    assert (grown / "tables/.DS_Store").read_text() == "mine"
    assert verify(grown).whole


@pytest.mark.slow
def test_what_campaigns_lack_is_told_until_they_have_it(first: Path, tmp_path: Path) -> None:
    root, out = Path(shutil.copytree(first, tmp_path / "root")), tmp_path / "out"
    waiting = SyntheticCampaign(root, campaign="batch", **SMALL)
    waiting.cell(waiting.record("random", 5, "low"), "low")
    grown = add_to_release(root, "growing", "one", out)
    manifest = find_baseline(grown).manifest
    assert (manifest.done, manifest.partial) == ({"batch": 4}, "batch has 4 of 5 runs")
    card = (grown / "README.md").read_text()
    assert "batch has 4 of 5 runs" in card
    assert "| planned runs | batch 5 |" in card
    with pytest.raises(BaselineError, match=r"4 of 5 runs.*--partial"):
        release(grown, "whole", out, contents=LEAN)
    waiting.run("random", 5)
    add_to_release(root, "growing", "two", out)
    assert find_baseline(grown).manifest.partial == ""


@pytest.mark.slow
def test_shards_are_merged_by_packing_the_release_anew(grown: Path, more: Path) -> None:
    add_to_release(more, "growing", "batch-2", grown.parent)
    merged = release(grown, "whole", grown.parent, contents=LEAN, about=About(gaps="Parkour."))
    manifest = find_baseline(merged).manifest
    assert (manifest.core, manifest.gaps) == (("batch",), "Parkour.")
    for table, name in (("evaluations", "original"), ("cells", "batch")):
        found = {path for path in files(merged) if path.startswith(f"tables/{table}")}
        assert found == {f"tables/{table}/{name}.parquet"}
    for table in (Table.CELLS, Table.RUNS, Table.ATTEMPTS):
        before, after = (Results.open(root).table(table).to_pylist() for root in (grown, merged))
        assert sorted(map(str, before)) == sorted(map(str, after))
    assert verify(merged).whole
    pd.testing.assert_frame_equal(load(merged).evaluations, load(grown).evaluations, check_exact=True)


def test_the_command_adds_shards(first, tmp_path, monkeypatch, told):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(BASELINES_VARIABLE, raising=False)
    said = ["--core", "batch", "--gaps", "Parkour has not begun."]
    assert told(0, "release", first, "growing", "--shard", "one", *said) == "growing\n"
    assert find_baseline("growing").manifest.gaps == "Parkour has not begun."
    assert "nothing to add" in told(2, "release", first, "growing", "--shard", "two")


def test_facts_about_a_release_change_without_new_runs(first: Path, grown: Path) -> None:
    before = files(grown)
    about = About(budget_note="Rankings at 5 million steps agree.", trial_cells=("original",))
    add_to_release(first, "growing", "note", grown.parent, about=about)
    described = {"README.md", "croissant.json", "baseline.json"}
    assert {name for name, content in files(grown).items() if before.get(name) != content} == described
    baseline = find_baseline(grown)
    facts = baseline.manifest.core, baseline.manifest.budget_note, baseline.manifest.trial_cells
    assert facts == (("batch",), about.budget_note, about.trial_cells)
    assert verify(grown).whole
    for name in ("README.md", "croissant.json"):
        assert about.budget_note in (grown / name).read_text()


def test_a_cell_of_trials_that_the_release_lacks_is_refused(first: Path, grown: Path) -> None:
    before = files(grown)
    with pytest.raises(ValueError, match="no cell 'orignal': did you mean 'original'"):
        add_to_release(first, "growing", "note", grown.parent, about=About(trial_cells=("orignal",)))
    assert files(grown) == before


def test_the_policy_of_the_run_in_the_middle_of_each_cell_is_released(tmp_path: Path) -> None:
    root, rng = batch(tmp_path / "root", range(4)), np.random.default_rng(0)
    space = gymnasium.spaces.Box(-1, 1, (24,))
    student = make_student("ppo", space, gymnasium.spaces.Box(-1, 1, (4,)), np.random.SeedSequence(0))
    for run_id in load(root).cells["run_id"]:
        folder = root / "policies" / run_id
        folder.mkdir(parents=True)
        student.save_policy(folder)
    contents = median_policies(root)
    released = load(release(root, "policies", tmp_path, contents=contents))
    areas = run_measures(load(root), training=False).merge(load(root).cells[["run_id", "teacher"]])
    for teacher, own in areas.groupby("teacher", observed=True):
        (ours,) = released.cells.loc[released.cells["teacher"] == teacher, "run_id"]
        below = own["mastered_area"] < own.set_index("run_id")["mastered_area"][ours]
        assert below.sum() == 1
        folders = [place / "policies" / ours for place in (root, tmp_path / "policies")]
        before, after = (load_policy("ppo", folder) for folder in folders)
        observations = rng.uniform(-1, 1, (50, 24)).astype(np.float32)
        difference = np.abs(before(observations) - after(observations)).max()
        assert 0 < difference < 2e-3
        weights = [(folder / "policy.safetensors").stat().st_size for folder in folders]
        assert weights[1] < 0.52 * weights[0]
    assert verify(tmp_path / "policies").whole
    manifest = find_baseline(tmp_path / "policies").manifest
    assert manifest.holds["policies"] == 2
    assert manifest.partial == "of each cell one run, that with the median result"
    assert not manifest.core_is_whole


def test_a_run_in_the_middle_without_a_policy_is_no_release_of_policies(first: Path, told: Told) -> None:
    with pytest.raises(BaselineError, match=r"2 of 2 runs .* have no policy in .*policies, as"):
        median_policies(first)
    with pytest.raises(ValueError, match=r"campaign 'bacth'.*the root has"):
        median_policies(first, ["bacth"])
    told(2, "release", first, "mine", "--policies", "--lean")


def test_released_policies_are_those_of_the_runs_with_the_median_results_of_lite_2() -> None:
    archive = Path(__file__).parents[2] / "releases" / "lite-2-policies"
    assert verify(archive).whole
    ours, lite_2 = load(archive), find_baseline("lite-2").frames()
    core = lite_2.cells[lite_2.cells["campaign"] == "lite_2_core"].drop_duplicates("run_id")
    areas = run_measures(lite_2, training=False).merge(core[["run_id", "teacher", "settings"]])
    cells = areas.groupby(["teacher", "settings"], observed=True)
    middle = cells["mastered_area"].transform("median")
    released = ours.cells["run_id"].astype(str)
    assert len(released) == cells.ngroups == 70
    assert not ours.cells.duplicated(["teacher", "settings"]).any()
    assert set(released) <= set(areas.loc[areas["mastered_area"] == middle, "run_id"].astype(str))
    order = ["run_id", "step", "task_index", "episodic_return"]
    rows = [frames.evaluations[order] for frames in (lite_2, ours)]
    before, after = (each[each["run_id"].isin(released)].sort_values(order[:3]) for each in rows)
    assert before["run_id"].astype(str).tolist() == after["run_id"].astype(str).tolist()
    returns = (frame["episodic_return"].to_numpy(np.float32) for frame in (before, after))
    np.testing.assert_array_equal(*returns)
    for run_id in released:
        folder = archive / "policies" / run_id
        width = len(json.loads((folder / "policy.json").read_text())["observation_space"]["low"])
        (actions,) = load_policy("ppo", folder)(np.zeros((1, width), np.float32))
        assert np.abs(actions).max() <= 1

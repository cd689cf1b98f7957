"""What `tma-ray verify` finds besides damaged files; runs whose manifest is gone."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from results_examples import OLD_ROOT

from tma_ray.cli import main
from tma_ray.results import Committer, Damage, Results, Store, compact, start_from, verify_root
from tma_ray.support.decoding import DamagedFileWarning

pytestmark = pytest.mark.filterwarnings("ignore::tma_ray.support.decoding.DamagedFileWarning")
FIRST, SECOND = "ppo_alp_gmm-s0-5e7c73111b9c", "sac_adr-s0-93c3a39a6c7a"


def edit(root: Path, run_id: str, change: Callable[[dict], None]) -> None:
    path = root / "manifests" / f"{run_id}.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def found(root: Path) -> list[Damage]:
    return list(verify_root(Store.open(root)).damage)


def test_a_root_is_whole_before_and_after_its_files_are_merged(old_root: Path) -> None:
    assert found(old_root) == []
    compact(old_root)
    assert found(old_root) == []


def test_a_spec_that_does_not_hash_to_the_id_is_damage(old_root: Path) -> None:
    edit(old_root, FIRST, lambda m: m["run"].update(spec=m["run"]["spec"].replace(" ", "", 1)))
    (damage,) = found(old_root)
    assert damage.path == f"manifests/{FIRST}.json"
    assert "does not hash to the end of the run's id" in damage.problem


@pytest.mark.parametrize(("name", "value"), [("seed", 7), ("teacher", "riac"), ("steps", 1)])
def test_columns_that_contradict_the_spec_are_damage(old_root: Path, name: str, value: object) -> None:
    edit(old_root, FIRST, lambda m: m["run"].update({name: value}))
    (damage,) = found(old_root)
    assert f"its {name} is {value!r}, but its spec says" in damage.problem


def test_rows_that_two_runs_claim_are_damage(old_root: Path) -> None:
    compact(old_root)
    files = {}
    edit(old_root, FIRST, lambda m: files.update({file["table"]: file for file in m["files"]}))

    def claim(manifest: dict) -> None:
        for file in manifest["files"]:
            file.update(first=files[file["table"]]["first"], rows=files[file["table"]]["rows"])

    edit(old_root, SECOND, claim)
    problems = {damage.problem for damage in found(old_root) if damage.path.startswith("tables/evaluations")}
    assert problems == {
        f"its rows from 0 on are also listed for run {FIRST}",
        "rows 0 and following are not this run's",
    }


def test_what_belongs_to_no_run_is_named_and_no_damage(old_root: Path) -> None:
    for path in ("tables/episodes/unknown.parquet", "policies/unknown/policy.json"):
        (old_root / path).parent.mkdir(exist_ok=True)
        (old_root / path).write_bytes(b"x")
    verification = verify_root(Store.open(old_root))
    assert verification.damage == ()
    assert verification.unlisted == ("tables/episodes/unknown.parquet", "policies/unknown/policy.json")


def test_a_policy_of_another_run_is_damage(old_root: Path) -> None:
    shutil.copy(old_root / f"policies/{SECOND}/spec.json", old_root / f"policies/{FIRST}/spec.json")
    (damage,) = found(old_root)
    assert (damage.path, damage.run_id) == (f"policies/{FIRST}/spec.json", FIRST)


def test_the_command_says_what_is_damaged(old_root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(old_root)]) == 0
    assert capsys.readouterr().out == f"{old_root} is whole; 2 runs, 10 files\n"
    (old_root / f"tables/episodes/{FIRST}.parquet").unlink()
    assert main(["verify", str(old_root)]) == 1
    assert f"run {FIRST}: tables/episodes/{FIRST}.parquet: it is missing\n" in capsys.readouterr().out
    assert main(["verify", str(old_root), "--json"]) == 1
    content = json.loads(capsys.readouterr().out)
    assert (content["whole"], content["runs"]) == (False, 2)
    path = f"tables/episodes/{FIRST}.parquet"
    assert content["damage"] == [{"path": path, "problem": "it is missing", "run_id": FIRST}]


def test_the_command_verifies_releases(old_root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    release = Path(shutil.copytree(OLD_ROOT.with_name("release"), old_root.parent / "release"))
    assert main(["verify", str(release)]) == 0
    (release / "added.md").write_text("x")
    assert main(["verify", str(release)]) == 1
    assert "added.md: it is not of this baseline" in capsys.readouterr().out


def drop(root: Path, *patterns: str) -> None:
    for pattern in patterns:
        for path in root.glob(pattern):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


@pytest.mark.parametrize(
    "more",
    [(), ("logs", "policies"), (f"tables/runs/{FIRST}.parquet",), (f"tables/[ret]*/{FIRST}.parquet", "logs")],
)
def test_a_run_without_its_manifest_is_named(old_root: Path, more: tuple[str, ...]) -> None:
    drop(old_root, f"manifests/{FIRST}.json", *more)
    missing = rf"manifests/{FIRST}\.json was left out: it is missing, although"
    with pytest.warns(DamagedFileWarning, match=missing):
        results = Results.open(old_root)
    assert [run.run.run_id for run in results.runs()] == [SECOND]
    damage = {(found.path, found.run_id) for found in verify_root(Store.open(old_root)).damage}
    assert (f"manifests/{FIRST}.json", FIRST) in damage


def test_a_merged_run_without_its_manifest_is_named(old_root: Path) -> None:
    compact(old_root)
    assert not Results.open(old_root).problems
    drop(old_root, f"manifests/{FIRST}.json", "logs", "policies")
    assert [problem.split("/")[-2] for problem in Results.open(old_root).problems] == ["runs"]
    assert {found.run_id for found in verify_root(Store.open(old_root)).damage} == {FIRST}


def test_it_is_done_again(old_root: Path) -> None:
    record = Results.open(old_root).find(FIRST).run
    drop(old_root, f"manifests/{FIRST}.json")
    committer = Committer.open(old_root)
    assert committer.done([FIRST, SECOND]) == {SECOND}
    assert committer.start(record) == 1
    assert not Results.open(old_root).problems


def test_a_run_that_was_about_to_start_is_not_lost(old_root: Path, tmp_path: Path) -> None:
    committer = Committer.open(old_root)
    record = Results.open(old_root).find(FIRST).run
    drop(old_root, f"manifests/{FIRST}.json", f"*/{FIRST}", f"tables/*/{FIRST}.parquet")
    committer.start(record)
    drop(old_root, f"manifests/{FIRST}.json")  # killed between the row of the run and its manifest
    assert not Results.open(old_root).problems
    # It copies the rows of all runs, and the manifests of those that are done.
    start_from(Store.open(tmp_path / "next"), Store.open(old_root))
    assert not Results.open(tmp_path / "next").problems

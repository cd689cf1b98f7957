"""What `tma-ray verify` finds besides damaged files, and how the command says it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tma_ray.cli import main
from tma_ray.results import Damage, Store, compact, verify_root

OLD_ROOT = Path(__file__).parents[1] / "compatibility" / "version_1" / "root"

FIRST, SECOND = "ppo_alp_gmm-s0-5e7c73111b9c", "sac_adr-s0-93c3a39a6c7a"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return Path(shutil.copytree(OLD_ROOT, tmp_path / "root"))


def edit(root: Path, run_id: str, change: Callable[[dict], None]) -> None:
    path = root / "manifests" / f"{run_id}.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def found(root: Path) -> list[Damage]:
    return list(verify_root(Store.open(root)).damage)


def test_a_root_is_whole_before_and_after_its_files_are_merged(root: Path) -> None:
    assert found(root) == []
    compact(root)
    assert found(root) == []


def test_a_spec_that_does_not_hash_to_the_id_is_damage(root: Path) -> None:
    edit(root, FIRST, lambda m: m["run"].update(spec=m["run"]["spec"].replace(" ", "", 1)))
    (damage,) = found(root)
    assert damage.path == f"manifests/{FIRST}.json"
    assert "does not hash to the end of the run's id" in damage.problem


@pytest.mark.parametrize(("name", "value"), [("seed", 7), ("teacher", "riac"), ("steps", 1)])
def test_columns_that_contradict_the_spec_are_damage(root: Path, name: str, value: object) -> None:
    edit(root, FIRST, lambda m: m["run"].update({name: value}))
    (damage,) = found(root)
    assert f"its {name} is {value!r}, but its spec says" in damage.problem


def test_rows_that_two_runs_claim_are_damage(root: Path) -> None:
    compact(root)
    files = {}
    edit(root, FIRST, lambda m: files.update({file["table"]: file for file in m["files"]}))

    def claim(manifest: dict) -> None:
        for file in manifest["files"]:
            file.update(first=files[file["table"]]["first"], rows=files[file["table"]]["rows"])

    edit(root, SECOND, claim)
    problems = {damage.problem for damage in found(root) if damage.path.startswith("tables/evaluations")}
    assert problems == {
        f"its rows from 0 on are also listed for run {FIRST}",
        "rows 0 and following are not this run's",
    }


def test_what_belongs_to_no_run_is_named_and_no_damage(root: Path) -> None:
    for path in ("tables/episodes/unknown.parquet", "policies/unknown/policy.json"):
        (root / path).parent.mkdir(exist_ok=True)
        (root / path).write_bytes(b"x")
    verification = verify_root(Store.open(root))
    assert verification.damage == ()
    assert verification.unlisted == ("tables/episodes/unknown.parquet", "policies/unknown/policy.json")


def test_a_policy_of_another_run_is_damage(root: Path) -> None:
    shutil.copy(root / f"policies/{SECOND}/spec.json", root / f"policies/{FIRST}/spec.json")
    (damage,) = found(root)
    assert (damage.path, damage.run_id) == (f"policies/{FIRST}/spec.json", FIRST)


def test_the_command_says_what_is_damaged_and_exits_with_1(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["verify", str(root)]) == 0
    assert capsys.readouterr().out == f"{root} is whole; 2 runs, 10 files\n"
    (root / f"tables/episodes/{FIRST}.parquet").unlink()
    assert main(["verify", str(root)]) == 1
    assert f"run {FIRST}: tables/episodes/{FIRST}.parquet: it is missing\n" in capsys.readouterr().out
    assert main(["verify", str(root), "--json"]) == 1
    content = json.loads(capsys.readouterr().out)
    assert (content["whole"], content["runs"]) == (False, 2)
    assert content["damage"] == [
        {"path": f"tables/episodes/{FIRST}.parquet", "problem": "it is missing", "run_id": FIRST}
    ]


def test_the_command_verifies_releases(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    release = Path(shutil.copytree(OLD_ROOT.parent / "release", root.parent / "release"))
    assert main(["verify", str(release)]) == 0
    (release / "added.md").write_text("x")
    assert main(["verify", str(release)]) == 1
    assert "added.md: it is not of this baseline" in capsys.readouterr().out

"""Runs whose manifest is gone are named, by what only a run that has started leaves; others are not."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tma_ray.decoding import DamagedFileWarning
from tma_ray.results import Committer, Results, Store, compact, start_from, verify_root

OLD_ROOT = Path(__file__).parents[1] / "compatibility" / "version_1" / "root"

RUN, OTHER = "ppo_alp_gmm-s0-5e7c73111b9c", "sac_adr-s0-93c3a39a6c7a"

pytestmark = pytest.mark.filterwarnings("ignore::tma_ray.decoding.DamagedFileWarning")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return Path(shutil.copytree(OLD_ROOT, tmp_path / "root"))


def drop(root: Path, *patterns: str) -> None:
    for pattern in patterns:
        for path in root.glob(pattern):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


@pytest.mark.parametrize(
    "more",
    [(), ("logs", "policies"), (f"tables/runs/{RUN}.parquet",), (f"tables/[ret]*/{RUN}.parquet", "logs")],
)
def test_a_run_without_its_manifest_is_named(root: Path, more: tuple[str, ...]) -> None:
    drop(root, f"manifests/{RUN}.json", *more)
    with pytest.warns(
        DamagedFileWarning, match=rf"manifests/{RUN}\.json was left out: it is missing, although"
    ):
        results = Results.open(root)
    assert [run.run.run_id for run in results.runs()] == [OTHER]
    damage = {(found.path, found.run_id) for found in verify_root(Store.open(root)).damage}
    assert (f"manifests/{RUN}.json", RUN) in damage


def test_a_merged_run_without_its_manifest_is_named(root: Path) -> None:
    compact(root)
    assert not Results.open(root).problems
    drop(root, f"manifests/{RUN}.json", "logs", "policies")
    assert [problem.split("/")[-2] for problem in Results.open(root).problems] == ["runs"]
    assert {found.run_id for found in verify_root(Store.open(root)).damage} == {RUN}


def test_it_is_done_again(root: Path) -> None:
    record = Results.open(root).find(RUN).run
    drop(root, f"manifests/{RUN}.json")
    committer = Committer.open(root)
    assert committer.done([RUN, OTHER]) == {OTHER}
    assert committer.start(record) == 1
    assert not Results.open(root).problems


def test_a_run_that_was_about_to_start_is_not_lost(root: Path, tmp_path: Path) -> None:
    committer = Committer.open(root)
    record = Results.open(root).find(RUN).run
    drop(root, f"manifests/{RUN}.json", f"*/{RUN}", f"tables/*/{RUN}.parquet")
    committer.start(record)
    drop(root, f"manifests/{RUN}.json")  # killed between the row of the run and its manifest
    assert not Results.open(root).problems
    start_from(Store.open(tmp_path / "next"), Store.open(root))  # copies rows of all, manifests of done runs
    assert not Results.open(tmp_path / "next").problems

"""The index of a release: one file with the manifests of all runs."""

import gzip
from dataclasses import replace
from pathlib import Path

import pytest
from results_examples import add_run

from tma_ray.results import (
    Committer,
    DamagedFileWarning,
    Manifest,
    Results,
    RunStatus,
    Store,
    Table,
    copy_merged,
    verify_root,
)
from tma_ray.results.layout import INDEX_FILE, manifest_path

RUNS = ("run-0", "run-1", "run-10")


@pytest.fixture
def root(tmp_path: Path) -> Store:
    store = Committer.open(tmp_path / "root").store
    for run_id in RUNS:
        add_run(store, run_id)
    return store


@pytest.fixture
def released(root: Store, tmp_path: Path) -> Store:
    store = Store.open(tmp_path / "released")
    copy_merged(Results(root), store)
    return store


def test_a_release_has_one_file_of_manifests_and_reads_as_its_root(root: Store, released: Store) -> None:
    assert released.files("manifests") == ()
    assert [each.run for each in Results(released).runs()] == [each.run for each in Results(root).runs()]
    for table in Table:
        assert Results(released).table(table).equals(Results(root).table(table)), table
    found = verify_root(released)
    assert (found.runs, found.damage, found.unlisted) == (3, (), ())


def test_a_damaged_line_leaves_the_others(released: Store) -> None:
    lines = gzip.decompress(released.read_bytes(INDEX_FILE)).splitlines()
    lines[1] = b"{"
    released.write_bytes(INDEX_FILE, gzip.compress(b"\n".join(lines), mtime=0))
    with pytest.warns(DamagedFileWarning) as warned:
        results = Results(released)
    assert "manifests.jsonl.gz line 2 was left out" in str(warned[0].message)
    assert [each.run.run_id for each in results.runs()] == ["run-0", "run-10"]
    assert any("line 2" in each.path for each in verify_root(released).damage)


def test_a_damaged_index_is_named_with_the_runs_that_it_held(released: Store) -> None:
    released.write_bytes(INDEX_FILE, released.read_bytes(INDEX_FILE)[:-20])
    with pytest.warns(DamagedFileWarning) as warned:
        assert Results(released).runs() == ()
    messages = " ".join(str(each.message) for each in warned)
    assert all(name in messages for name in (INDEX_FILE, *RUNS))


def test_a_manifest_of_its_own_has_precedence_over_a_line(released: Store) -> None:
    indexed = Manifest.load(released, "run-1")
    own = replace(indexed, status=RunStatus.FAILED, error="again")
    released.write_bytes(manifest_path("run-1"), own.to_bytes())
    assert [each.status for each in Results(released).runs()] == ["done", "failed", "done"]
    assert Manifest.load(released, "run-1") == own


def test_a_campaign_on_a_release_knows_its_runs(released: Store) -> None:
    assert Committer(released).done([*RUNS, "run-2"]) == set(RUNS)
    with pytest.raises(FileNotFoundError):
        Manifest.load(released, "run-2")

"""Columns that are added later: old roots are read, merged, continued and tabulated with them."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from results_examples import make_record

from analysis import load
from tma_ray.results import (
    SCHEMAS,
    Committer,
    DamagedFileError,
    DamagedFileWarning,
    Results,
    RunWriter,
    Table,
    compact,
    copy_merged,
    verify_root,
)
from tma_ray.results import Store as ResultsStore

ADDED = {
    Table.EVALUATIONS: pa.field("falls", pa.int32(), nullable=True),
    Table.EPISODES: pa.field("precision", pa.string(), nullable=False, metadata={"default": '"float32"'}),
    Table.ATTEMPTS: pa.field("memory", pa.float64(), nullable=True, metadata={"unit": "bytes"}),
    Table.CELLS: pa.field("tier", pa.dictionary(pa.int32(), pa.string()), nullable=True),
    Table.RUNS: pa.field("device", pa.string(), nullable=False, metadata={"default": '"cpu"'}),
}


@pytest.fixture
def newer(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Add a column to most tables, until this is undone."""
    with monkeypatch.context() as patch:
        for table, field in ADDED.items():
            patch.setitem(SCHEMAS, table, SCHEMAS[table].append(field))
        yield patch


ROW = {"step": 0, "test_set": "grid", "task_index": 0, "task": [0.5], "episodic_return": 1.0, "length": 7}


def new_run(store: ResultsStore) -> None:
    committer, record = Committer(store), make_record("new")
    writer = RunWriter(store, "new", committer.start(record))
    writer.add(Table.EVALUATIONS, [ROW | {"falls": 3}])
    committer.finish(record, writer.attempt, writer.finish())


@pytest.mark.usefixtures("newer")
def test_old_rows_have_null_or_the_default(old_root: Path) -> None:
    results = Results.open(old_root)
    for table, field in ADDED.items():
        values = set(results.table(table)[field.name].to_pylist())
        assert values == {json.loads(field.metadata[b"default"]) if not field.nullable else None}
        alone = results.table(table, columns=[field.name])
        assert len(alone) == len(results.table(table)) > 0
    assert not results.problems
    assert load(old_root).evaluations["mastered"].notna().all()
    assert verify_root(ResultsStore.open(old_root)).damage == ()


@pytest.mark.usefixtures("newer")
def test_old_and_new_files_are_merged_and_copied_together(old_root: Path, tmp_path: Path) -> None:
    store = ResultsStore.open(old_root)
    new_run(store)
    before = Results(store).table(Table.EVALUATIONS)
    compact(old_root)
    merged = Results(store).table(Table.EVALUATIONS)
    assert merged.to_pylist() == before.to_pylist()
    assert set(merged["falls"].to_pylist()) == {None, 3}
    target = ResultsStore.open(tmp_path / "copy")
    assert copy_merged(Results(store), target).damaged == ()
    assert Results(target).table(Table.EVALUATIONS).to_pylist() == before.to_pylist()


def test_a_run_goes_on_from_parts_of_fewer_columns(old_root: Path, request: pytest.FixtureRequest) -> None:
    store, record = ResultsStore.open(old_root), make_record("long")
    committer = Committer(store)
    writer = RunWriter(store, "long", committer.start(record))
    writer.add(Table.EVALUATIONS, [ROW])
    parts = writer.flush()
    request.getfixturevalue("newer")
    writer = RunWriter(store, "long", committer.start(record), parts)
    writer.add(Table.EVALUATIONS, [ROW | {"step": 10, "falls": 2}])
    committer.finish(record, writer.attempt, writer.finish())
    assert Results(store).table(Table.EVALUATIONS, ["long"])["falls"].to_pylist() == [None, 2]


@pytest.mark.filterwarnings("ignore:.*written by a newer")
def test_columns_of_the_future_are_kept(old_root: Path, tmp_path: Path, newer: pytest.MonkeyPatch) -> None:
    store = ResultsStore.open(old_root)
    new_run(store)
    newer.undo()
    path = old_root / "manifests" / "new.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"a_newer_field": [1]}))
    results = Results(store)
    assert results.table(Table.EVALUATIONS, ["new"])["episodic_return"].to_pylist() == [1.0]
    assert not results.problems
    with pytest.warns(DamagedFileWarning, match=r"evaluations/new\.parquet was written by a newer"):
        compact(old_root)
    assert store.exists("tables/evaluations/new.parquet")
    with pytest.raises(DamagedFileError, match="written by a newer"):
        copy_merged(Results(store), ResultsStore.open(tmp_path / "copy"))


def test_a_column_that_has_always_been_there_is_missed(old_root: Path) -> None:
    store = ResultsStore.open(old_root)
    path = store.files("tables/cells")[0]
    pq.write_table(pa.table({"campaign": ["c"]}), old_root / path)
    missed = r"cells/.*no column 'experiment', which cells has always had"
    with pytest.warns(DamagedFileWarning, match=missed):
        assert len(Results(store).table(Table.CELLS)) == 0


def test_the_threshold_of_mastery_is_a_column_of_runs(old_root: Path, tmp_path: Path) -> None:
    """Old files do not have it, and stay as they are; what is written from their runs has it."""
    old = sorted((old_root / "tables/runs").iterdir())
    assert not any("mastery_threshold" in pq.read_schema(path).names for path in old)
    assert set(Results.open(old_root).table(Table.RUNS)["mastery_threshold"].to_pylist()) == {230.0}
    store = ResultsStore.open(tmp_path / "new")
    committer = Committer(store)
    for run_id, spec, threshold in (("silent", "{}", 230.0), ("told", '{"mastery_threshold": -12.5}', -12.5)):
        record = replace(make_record(run_id), spec=spec)
        writer = RunWriter(store, run_id, committer.start(record))
        committer.finish(record, writer.attempt, writer.finish())
        row = pq.read_table(tmp_path / f"new/tables/runs/{run_id}.parquet", columns=["mastery_threshold"])
        assert row["mastery_threshold"].to_pylist() == [threshold]
    copy_merged(Results.open(old_root), ResultsStore.open(tmp_path / "copy"))
    for path in (tmp_path / "copy/tables/runs").iterdir():
        assert set(pq.read_table(path)["mastery_threshold"].to_pylist()) == {230.0}

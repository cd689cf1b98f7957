"""Merged files: they read as what they were merged from, at any time, and nothing written is ever lost."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from results_examples import add_run, make_cell, sibling, tree

from tma_ray.results import (
    DATA_TABLES,
    AttemptOutcome,
    AttemptRecord,
    Committer,
    Copy,
    DamagedFileError,
    DamagedFileWarning,
    Lease,
    Results,
    ResultsRootError,
    RootInUseError,
    RunStatus,
    Store,
    Table,
    compact,
    compaction,
    copy_merged,
    manifest,
)

RUNS = {"first": ["run-00", "run-01", "run-02", "run-03"], "second": ["run-00a"]}


@pytest.fixture(autouse=True)
def open_store(monkeypatch: pytest.MonkeyPatch, store: Store) -> None:
    """Let `compact` work on stores that have no address, and three runs be many."""
    monkeypatch.setattr(Store, "open", classmethod(lambda cls, root: root))
    monkeypatch.setattr(manifest, "MOST_SLICES", 2)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with finished runs of two experiments, and one that stands."""
    folder = tmp_path_factory.mktemp("written") / "root"
    committer = Committer(Store.open(folder))
    for experiment, run_ids in RUNS.items():
        for run_id in run_ids:
            add(committer, run_id)
        add_cells(committer, experiment, run_ids)
    add(committer, "run-99", finished=False)
    return folder


@pytest.fixture
def root(store: Store, written: Path) -> Store:
    for path in written.rglob("*"):
        if path.is_file():
            store.write_bytes(path.relative_to(written).as_posix(), path.read_bytes())
    return store


def add(committer: Committer, run_id: str, *, finished: bool = True) -> None:
    empty = Table.TRAINING if run_id == "run-03" else None
    add_run(committer.store, run_id, (0, 10), finished=finished, empty=empty)
    for attempt in range(2):
        started = datetime(2026, 11, 20, tzinfo=UTC)
        measured = (started, 1.0, 2.0, f"host-{run_id}", "{}")
        committer.record_attempt(AttemptRecord(run_id, attempt, *measured, AttemptOutcome.DONE))


def add_cells(committer: Committer, experiment: str, run_ids: list[str]) -> None:
    committer.write_cells(experiment, [make_cell(name, i, experiment) for i, name in enumerate(run_ids)])


def content(store: Store) -> dict[str, object]:
    """All tables, with the dictionaries that frames and groups see; damage would be an error."""
    results = Results(store)
    found = {table: results.table(table) for table in Table}
    assert results.problems == []
    frames = {name: rows.to_pandas(strings_to_categorical=True) for name, rows in found.items()}
    orders = {
        (name, column): list(frame[column].cat.categories)
        for name, frame in frames.items()
        for column in frame.select_dtypes("category")
    }
    return {name: repr(rows.to_pylist()) for name, rows in found.items()} | orders


def files_of(root: Store, table: str) -> list[str]:
    return [Path(path).stem for path in root.files(f"tables/{table}")]


def test_merged_files_read_as_before(root: Store) -> None:
    before, earlier = content(root), Results(root)
    data = {table: earlier.table(table).to_pylist() for table in DATA_TABLES}
    outcome = compact(root)
    assert content(root) == before
    assert outcome.runs == sum(map(len, RUNS.values()))
    assert files_of(root, "episodes") == ["first", "second"]
    assert files_of(root, "attempts") == ["first", "run-99", "second"]
    assert outcome.files_after == len(root.files("tables")) < outcome.files_before
    assert not {"lease.json", "compacting.json"} & set(root.files())
    assert {table: earlier.table(table).to_pylist() for table in DATA_TABLES} == data, "opened before"
    assert earlier.problems == []
    merged = tree(root)
    assert compact(root).runs == 0
    assert tree(root) == merged


@pytest.mark.parametrize("run_ids", [["run-03"], ["run-00a", "run-02", "run-99"], RUNS["first"]], ids=str)
def test_some_runs_and_columns_read_as_before(root: Store, run_ids: list[str]) -> None:
    tables = (*DATA_TABLES, Table.ATTEMPTS)
    before = [Results(root).table(table, run_ids, ["run_id"]) for table in tables]
    compact(root)
    after = [Results(root).table(table, run_ids, ["run_id"]) for table in tables]
    assert [rows.to_pylist() for rows in after] == [rows.to_pylist() for rows in before]


def test_later_runs_are_merged_with_the_earlier_ones(root: Store) -> None:
    compact(root)
    committer = Committer(root)
    add(committer, "run-05c")
    add_cells(committer, "first", [*RUNS["first"], "run-05c"])
    before = content(root)
    assert compact(root).runs == len(RUNS["first"]) + 1
    assert content(root) == before
    assert files_of(root, "episodes") == ["first-2", "second"]
    assert "first" not in files_of(root, "attempts")


def test_a_campaign_goes_on_after_it(root: Store) -> None:
    compact(root)
    committer = Committer(root)
    assert committer.manifest("run-03").status is RunStatus.DONE
    committer.sweep()
    add(committer, "run-99")
    assert len(Results(root).table(Table.TRAINING, ["run-99"])) == 2


class KilledError(Exception):
    pass


@pytest.mark.parametrize("store", ["local"], indirect=True)
def test_a_kill_anywhere_changes_nothing_read(root: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    before = content(root)
    killed = 0
    for allowed in range(0, 40, 3):  # writes and deletions before a kill
        left = [allowed]

        def counted(method: str, left: list[int] = left) -> object:
            original = getattr(type(root), method)

            def call(self: Store, *arguments: object) -> object:
                if arguments[0] not in ("lease.json", "stop.json"):
                    left[0] -= 1
                    if left[0] < 0:
                        raise KilledError
                return original(self, *arguments)

            return call

        with monkeypatch.context() as patch:
            for method in ("write_bytes", "delete"):
                patch.setattr(type(root), method, counted(method))
            try:
                compact(root)
            except KilledError:
                killed += 1
        assert content(root) == before
    assert killed > 3
    compact(root)
    assert content(root) == before
    assert len(root.files("tables/episodes")) == 2
    assert len(root.files("tables/attempts")) == len(root.files("tables/runs")) == 3


def test_a_root_in_use_is_refused(root: Store) -> None:
    before = content(root)
    with Lease(root, "a campaign"), pytest.raises(RootInUseError, match="in use by a campaign"):
        compact(root)
    assert content(root) == before


@pytest.mark.parametrize("path", ["tables/episodes/run-02.parquet", "manifests/run-02.json"])
def test_damaged_runs_are_named_and_stay_as_they_are(root: Store, path: str) -> None:
    data = root.read_bytes(path)
    root.write_bytes(path, data[: len(data) // 2])
    before = tree(root, keep=lambda path: "run-02" in path)
    with pytest.warns(DamagedFileWarning, match=path.replace(".", r"\.")):
        assert compact(root).runs == 4
    assert tree(root, keep=lambda path: "run-02" in path) == before
    root.write_bytes(path, data)
    assert not Results(root).problems
    assert compact(root).runs == 4, "all of its experiment"
    assert len(Results(root).table(Table.EPISODES, ["run-00", "run-02"])) == 12


def test_files_written_otherwise_are_noticed(root: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    before = content(root)
    rows = Results(root).table(Table.EVALUATIONS, ["run-01"])
    names = compaction.pack.__globals__
    original = names["encode_together"]

    def encode(table: Table, parts: list[Any]) -> object:
        return original(table, [rows for _ in parts] if table is Table.EVALUATIONS else parts)

    monkeypatch.setitem(names, "encode_together", encode)
    with pytest.raises(DamagedFileError, match="does not hold what run run-00"):
        compact(root)
    assert content(root) == before


def test_damage_of_a_merged_file_is_named(root: Store) -> None:
    compact(root)
    path = "tables/training/first.parquet"
    data = bytearray(root.read_bytes(path))
    data[len(data) // 2] ^= 1
    root.write_bytes(path, bytes(data))
    results = Results(root)
    with pytest.warns(DamagedFileWarning, match=r"training/first\.parquet"):
        rows = results.table(Table.TRAINING)
    assert set(rows["run_id"].to_pylist()) == {*RUNS["second"], "run-99"}
    assert len(results.problems) == 1


def test_a_copy_holds_all_that_is_said_of_the_runs(root: Store, tmp_path: object) -> None:
    root.write_bytes("policies/run-01/policy.json", b"{}")
    root.write_bytes("policies/run-01/policy.pkl", b"danger")
    before = content(root)
    target = sibling(root, "-copy")
    assert copy_merged(Results(root), target) == Copy(("policies/run-01/policy.pkl",), ())
    assert content(target) == before
    assert content(root) == before
    assert target.files("policies") == ("policies/run-01/policy.json",)
    assert not target.files("staging")
    with pytest.raises(ResultsRootError, match="neither empty"):
        copy_merged(Results(root), sibling(root, "-copy/tables"))

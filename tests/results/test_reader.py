import re
import warnings
from typing import Any

import pytest
from results_examples import add_run, make_record

from tma_ray.results import (
    DATA_TABLES,
    SCHEMAS,
    Committer,
    DamagedFileWarning,
    Results,
    RunStatus,
    RunWriter,
    Store,
    Table,
)


def test_runs_come_by_id_and_their_rows_as_written(store: Store) -> None:
    add_run(store, "run-b", (0, 10))
    add_run(store, "run-a", (0,), finished=False)
    results = Results(store)
    states = [(m.run.run_id, m.status) for m in results.runs()]
    assert states == [("run-a", RunStatus.RUNNING), ("run-b", RunStatus.DONE)]
    episodes = results.table(Table.EPISODES, columns=["step", "run_id"])
    assert episodes.column_names == ["step", "run_id"]
    assert episodes.to_pylist() == [
        {"step": step, "run_id": run_id}
        for run_id, steps in (("run-a", (0, 1, 2)), ("run-b", (0, 1, 2, 10, 11, 12)))
        for step in steps
    ]
    assert results.problems == []


@pytest.mark.parametrize("table", Table)
def test_tables_have_their_schema_with_and_without_rows(store: Store, table: Table) -> None:
    Committer(store)
    assert Results(store).table(table).schema.equals(SCHEMAS[table], check_metadata=False)
    add_run(store, "run-a", (0,))
    add_run(store, "run-b", (10,))
    found = Results(store).table(table)
    assert found.schema.equals(SCHEMAS[table])
    assert (len(found) > 0) == (table in (*DATA_TABLES, Table.RUNS))


def test_only_the_runs_and_columns_asked_for_are_read(store: Store) -> None:
    for run_id in ("run-a", "run-b", "run-c"):
        add_run(store, run_id, (0,))
    store.delete("tables/training/run-b.parquet")  # would be noticed
    results = Results(store)
    for table in (Table.TRAINING, Table.RUNS):
        rows = results.table(table, run_ids=["run-c", "run-a", "never-begun"], columns=["run_id"])
        assert rows["run_id"].to_pylist() == ["run-a", "run-c"]
    assert results.problems == []
    with pytest.raises(ValueError, match="training has no column 'loss'"):
        results.table(Table.TRAINING, columns=["step", "loss"])


def test_ids_of_all_runs_share_one_dictionary(store: Store) -> None:
    for run_id in ("run-a", "run-b"):
        add_run(store, run_id, (0,))
    counts = Results(store).table(Table.EPISODES).group_by("run_id").aggregate([("success", "count")])
    found = sorted((row["run_id"], row["success_count"]) for row in counts.to_pylist())
    assert found == [("run-a", 3), ("run-b", 3)]


@pytest.mark.parametrize("damage", ["truncated", "one byte changed", "gone", "of another run"])
def test_a_damaged_file_is_named_and_the_rest_loads(store: Store, damage: str) -> None:
    for run_id in ("run-a", "run-b", "run-c"):
        add_run(store, run_id, (0, 10) if run_id == "run-c" else (0,))
    path = "tables/episodes/run-b.parquet"
    data = store.read_bytes(path)
    damaged = {
        "truncated": data[:100],
        "one byte changed": data[:50] + bytes([data[50] ^ 1]) + data[51:],
        "of another run": store.read_bytes("tables/episodes/run-c.parquet"),
    }
    store.delete(path) if damage == "gone" else store.write_bytes(path, damaged[damage])
    results = Results(store)
    with pytest.warns(DamagedFileWarning, match=r"tables/episodes/run-b\.parquet was left out"):
        rows = results.table(Table.EPISODES)
    assert rows["run_id"].to_pylist() == ["run-a"] * 3 + ["run-c"] * 6
    assert len(results.problems) == 1
    assert len(results.table(Table.TRAINING)) == 4


LIES = [
    ("path", "../../secret.parquet"),
    ("path", "/etc/passwd"),
    ("path", "tables//episodes.parquet"),
    ("path", "..\\\\secret.parquet"),
    ("run_id", "../../somewhere"),
    ("run_id", "run-b"),
]
"""Values of fields with which a manifest would lead elsewhere."""


@pytest.mark.parametrize("damage", [b"", b"{", b"[1]", b'{"run": {}}', b"\xff", *LIES])
def test_a_damaged_or_hostile_manifest_is_named_and_the_other_runs_load(store: Store, damage: Any) -> None:
    for run_id in ("run-a", "run-b"):
        add_run(store, run_id, (0,))
    if isinstance(damage, tuple):
        (field, lie), text = damage, store.read_bytes("manifests/run-a.json").decode()
        damage = re.sub(rf'"{field}": "[^"]*"', lambda _: f'"{field}": "{lie}"', text).encode()
        assert damage != text.encode()
    store.write_bytes("manifests/run-a.json", damage)
    with pytest.warns(DamagedFileWarning, match=r"manifests/run-a\.json"):
        results = Results(store)
    assert [m.run.run_id for m in results.runs()] == ["run-b"]
    assert results.table(Table.EPISODES)["run_id"].unique().to_pylist() == ["run-b"]


def test_a_damaged_table_about_runs_is_named(store: Store) -> None:
    Committer(store)
    store.write_bytes("tables/cells/stumps.parquet", b"PAR1")
    results = Results(store)
    with pytest.warns(DamagedFileWarning, match=r"tables/cells/stumps\.parquet"):
        assert len(results.table(Table.CELLS)) == 0


def test_a_run_that_ends_while_it_is_read_is_read_once(store: Store) -> None:
    parts = add_run(store, "run-a", (0, 10), finished=False)
    results = Results(store)
    before = results.table(Table.EVALUATIONS)
    Committer(store).finish(make_record("run-a"), 0, RunWriter(store, "run-a", 0, parts).finish())
    assert not store.exists(parts[0].path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert results.table(Table.EVALUATIONS).equals(before)

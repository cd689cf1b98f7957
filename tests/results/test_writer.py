from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from obstore.store import MemoryStore
from results_examples import make_rows, tree

from tma_ray.results import DATA_TABLES, DamagedFileError, PartFile, RunWriter, Store, Table
from tma_ray.results.parquet import decode
from tma_ray.results.storage import BucketStore

INTERVALS = 8
ROWS = [make_rows(np.random.default_rng(step), step) for step in range(0, 10 * INTERVALS, 10)]


def canonical_bytes(store: Store, final: tuple[PartFile, ...]) -> dict[Table, bytes]:
    return {file.table: file.read(store) for file in final}


def memory() -> Store:
    return BucketStore(MemoryStore(), "s3://bucket/root")


def written_whole(store: Store) -> dict[Table, bytes]:
    writer = RunWriter(store, "run-1", 0)
    for rows in ROWS:
        for table, some in rows:
            writer.add(table, some)
    return canonical_bytes(store, writer.finish())


@settings(max_examples=10, deadline=None)
@given(
    flushes=st.sets(st.integers(1, INTERVALS - 1)),
    kills=st.lists(st.tuples(st.integers(1, INTERVALS), st.integers(0, 3)), max_size=3),
)
def test_any_split_over_attempts_gives_equal_files(flushes: set[int], kills: list[tuple[int, int]]) -> None:
    """A kill comes after some intervals; the next attempt resumes from the last flush."""
    store = memory()
    committed: tuple[PartFile, ...] = ()
    resume_at = 0
    for attempt, (survives, lost_flushes) in enumerate([*kills, (INTERVALS, 0)]):
        writer = RunWriter(store, "run-1", attempt, [replace(part) for part in committed])
        for interval in range(resume_at, max(survives, resume_at)):
            for table, rows in ROWS[interval]:
                writer.add(table, rows)
            if interval + 1 in flushes:
                committed, resume_at = writer.flush(), interval + 1
        for _ in range(lost_flushes):  # parts that no checkpoint ever names
            writer.add(Table.CURRICULUM, [{"step": 1, "sample": 1, "task": [0.0]}])
            writer.flush()
    assert canonical_bytes(store, writer.finish()) == written_whole(memory())


def test_parts_hold_what_was_added_since_the_last_flush(store: Store) -> None:
    writer = RunWriter(store, "run-1", 2)
    assert writer.flush() == ()
    for table, rows in ROWS[1]:
        writer.add(table, rows)
    first = writer.flush()
    assert [part.table for part in first] == list(DATA_TABLES)
    assert first[0].path == "staging/run-1/attempt-002/part-00000/evaluations.parquet"
    assert writer.flush() == first
    writer.add(*ROWS[2][0])
    second = writer.flush()
    assert second[:-1] == first
    assert second[-1].path == "staging/run-1/attempt-002/part-00001/evaluations.parquet"
    rows = decode(second[-1].table, second[-1].read(store)).to_pylist()
    assert second[-1].rows == len(rows) == len(ROWS[2][0][1])
    assert {row["run_id"] for row in rows} == {"run-1"}
    assert [row["task_index"] for row in rows] == [row["task_index"] for row in ROWS[2][0][1]]


def test_an_attempt_never_touches_the_files_of_another(store: Store) -> None:
    zombie = RunWriter(store, "run-1", 0)
    zombie.add(*ROWS[0][0])
    committed = zombie.flush()
    before = tree(store)
    successor = RunWriter(store, "run-1", 1, committed)
    for writer, rows in ((successor, ROWS[1]), (zombie, ROWS[2]), (successor, ROWS[3])):
        writer.add(*rows[0])
        writer.flush()
    assert before.items() <= tree(store).items()
    steps = decode(Table.EVALUATIONS, successor.finish()[0].read(store))["step"].to_pylist()
    assert sorted(set(steps)) == [ROWS[i][0][1][0]["step"] for i in (0, 1, 3)]
    assert all(earlier <= later for earlier, later in pairwise(steps))


def test_a_writer_made_anew_within_an_attempt_keeps_what_is_committed(store: Store) -> None:
    writer = RunWriter(store, "run-1", 0)
    for rows in ROWS[:3]:
        writer.add(*rows[0])
        committed = writer.flush()
    writer = RunWriter(store, "run-1", 0, committed)
    writer.add(*ROWS[3][0])
    parts = writer.flush()
    assert parts[:-1] == committed
    steps = [decode(part.table, part.read(store))["step"][0].as_py() for part in parts]
    assert steps == [rows[0][1][0]["step"] for rows in ROWS[:4]]


def test_every_data_table_ends_as_one_file_also_without_rows(store: Store) -> None:
    final = RunWriter(store, "run-1", 0).finish()
    assert [(file.table, file.rows) for file in final] == [(table, 0) for table in DATA_TABLES]
    assert all(len(decode(file.table, file.read(store))) == 0 for file in final)


GOOD = {"step": 1, "sample": 0, "task": [0.5]}


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"step": 1, "sample": 0}, "missing: task"),
        (GOOD | {"sample": None}, "missing: sample"),
        (GOOD | {"reward": 1.0}, "unknown: reward"),
        (GOOD | {"run_id": "other"}, "unknown: run_id"),
        (GOOD | {"step": "one"}, r"curriculum\.step"),
        (GOOD | {"step": 1.5}, r"curriculum\.step"),
        (GOOD | {"task": [[0.5]]}, r"curriculum\.task"),
    ],
)
def test_rows_that_do_not_fit_are_refused(tmp_path: Path, row: dict[str, object], message: str) -> None:
    writer = RunWriter(Store.open(tmp_path), "run-1", 0)
    with pytest.raises(ValueError, match=message):
        writer.add(Table.CURRICULUM, [GOOD, row])
    assert writer.flush() == ()


def test_tables_of_the_committer_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="written by the committer"):
        RunWriter(Store.open(tmp_path), "run-1", 0).add(Table.RUNS, [])


def test_parts_of_another_run_are_refused(tmp_path: Path) -> None:
    part = PartFile(Table.EPISODES, "staging/run-10/attempt-000/part-00000/episodes.parquet", 1, "")
    with pytest.raises(ValueError, match="does not belong to run run-1"):
        RunWriter(Store.open(tmp_path), "run-1", 1, [part])


def test_a_damaged_part_never_reaches_a_canonical_file(store: Store) -> None:
    writer = RunWriter(store, "run-1", 0)
    writer.add(*ROWS[0][0])
    (part,) = writer.flush()
    store.write_bytes(part.path, store.read_bytes(part.path)[:-1])
    with pytest.raises(DamagedFileError, match=r"part-00000/evaluations\.parquet"):
        writer.finish()

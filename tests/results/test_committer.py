import copy
import json
import warnings
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import count
from typing import Any

import msgspec
import numpy as np
import pytest
from results_examples import TASKS_PER_EVALUATION, make_cell, make_record, make_rows, sibling, tree

from tma_ray.results import (
    DATA_TABLES,
    AttemptOutcome,
    AttemptRecord,
    Committer,
    PartFile,
    Results,
    RunRecord,
    RunStatus,
    RunWriter,
    StaleAttemptError,
    Store,
    Table,
)

STEPS = (0, 10)
CHECKPOINT = "checkpoints/run-1/parts.json"


class Killed(BaseException):
    """The process is gone; nothing catches this."""


def mortal(store: Store, life: int) -> Store:
    """A store whose process is killed before the operation number `life`, counted from 0."""
    mortal, left = copy.copy(store), [life]

    def spending(operation: Callable[..., Any]) -> Callable[..., Any]:
        def spend(*arguments: Any) -> Any:
            if left[0] == 0:
                raise Killed
            left[0] -= 1
            return operation(*arguments)

        return spend

    for name in ("write_bytes", "move", "delete"):
        setattr(mortal, name, spending(getattr(store, name)))
    return mortal


def campaign_of_one_run(store: Store, record: RunRecord) -> None:
    """What a campaign does for a run: first launch, or resume after a kill of everything."""
    committer = Committer(store)
    committer.sweep()
    published = committer.manifest(record.run_id)
    if published is not None and published.status is RunStatus.DONE:
        return
    attempt = committer.start(record)
    done, parts = 0, []
    if store.exists(CHECKPOINT):
        checkpoint = json.loads(store.read_bytes(CHECKPOINT))
        done, parts = checkpoint["done"], msgspec.convert(checkpoint["parts"], list[PartFile])
    writer = RunWriter(store, record.run_id, attempt, parts)
    for number, step in enumerate(STEPS[done:], start=done + 1):
        for table, rows in make_rows(np.random.default_rng(step), step):
            writer.add(table, rows)
        parts = writer.flush()
        content = {"done": number, "parts": [part.to_json() for part in parts]}
        store.write_bytes(CHECKPOINT, json.dumps(content).encode())
        committer.publish(record, attempt, parts)
    committer.finish(record, attempt, writer.finish())


def visible_steps(store: Store) -> list[int]:
    """Step of the visible evaluations, after a check that each is there once and whole."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rows = Results(store).table(Table.EVALUATIONS).to_pylist()
    steps = sorted({row["step"] for row in rows})
    expected = [(step, index) for step in steps for index in range(TASKS_PER_EVALUATION)]
    assert [(row["step"], row["task_index"]) for row in rows] == expected
    return steps


def begun(store: Store, record: RunRecord) -> tuple[Committer, RunWriter, tuple[PartFile, ...]]:
    """Start an attempt whose rows of one evaluation are flushed, and not published."""
    committer = Committer(store)
    writer = RunWriter(store, record.run_id, committer.start(record))
    writer.add(*make_rows(np.random.default_rng(0), 0)[0])
    return committer, writer, writer.flush()


def in_tables(path: str) -> bool:
    """All but the attempts, of which each life has one more."""
    return path.startswith("tables/") and not path.startswith("tables/attempts/")


def test_a_kill_between_any_two_file_operations_loses_and_doubles_nothing(store: Store) -> None:
    record = make_record("run-1")
    reference = sibling(store, "-reference")
    campaign_of_one_run(reference, record)
    # A disk flushes every write, a server answers every request: there, not all lives are tried.
    for life in count(step=3):
        root = sibling(store, f"-{life}")
        try:
            campaign_of_one_run(mortal(root, life), record)
        except Killed:
            pass
        else:
            break
        before: list[int] = []
        if root.exists("root.json"):
            published = Committer(root).manifest("run-1")
            before = visible_steps(root)
            files = published.files if published else ()
            assert len(before) == sum(f.rows for f in files if f.table is Table.TRAINING)
        campaign_of_one_run(root, record)
        assert visible_steps(root) == list(STEPS)
        assert tree(root, keep=in_tables) == tree(reference, keep=in_tables)
        assert root.files("staging") == ()
        attempts = Results(root).table(Table.ATTEMPTS).to_pylist()
        assert [row["attempt"] for row in attempts] == list(range(len(attempts)))
        assert {row["outcome"] for row in attempts} <= {"lost"}, "nobody records here that one is done"
    assert life > 20


def test_runs_are_visible_from_their_start_and_rows_when_published(store: Store, record: RunRecord) -> None:
    committer, writer, parts = begun(store, record)
    assert [(m.run, m.status) for m in Results(store).runs()] == [(record, RunStatus.RUNNING)]
    assert visible_steps(store) == []
    committer.publish(record, 0, parts)
    assert visible_steps(store) == [0]
    assert not store.exists("tables/evaluations/run-1.parquet")
    final = writer.finish()
    assert visible_steps(store) == [0]
    committer.finish(record, 0, final)
    assert visible_steps(store) == [0]
    files = {path for path in store.files("tables") if "/runs/" not in path}
    assert files == {f"tables/{table}/run-1.parquet" for table in DATA_TABLES}
    row = Results(store).table(Table.RUNS).to_pylist()[0]
    assert (row["status"], row["error"], row["spec"]) == ("done", None, "{}")


def test_every_step_may_be_repeated(store: Store, record: RunRecord) -> None:
    committer, writer, parts = begun(store, record)
    final = writer.finish()
    for step in (
        lambda: committer.publish(record, 0, parts),
        lambda: committer.fail(record, 0, "boom"),
        lambda: committer.finish(record, 0, final),
        committer.sweep,
    ):
        step()
        once = tree(store)
        step()
        assert tree(store) == once


def test_a_kill_within_the_end_of_a_run_is_made_good_by_repeating_it(store: Store, record: RunRecord) -> None:
    for life in count():
        root = sibling(store, f"-{life}")
        committer, writer, parts = begun(root, record)
        committer.publish(record, 0, parts)
        final = writer.finish()
        try:
            Committer(mortal(root, life)).finish(record, 0, final)
        except Killed:
            assert visible_steps(root) == [0]
            committer.finish(record, 0, final)
        else:
            break
        assert visible_steps(root) == [0]
        assert len(root.files("staging")) == 0
        assert committer.manifest("run-1").status is RunStatus.DONE
    assert life == len(DATA_TABLES) + 3  # moves, row, manifest, staging


def test_an_older_attempt_is_fenced_off_as_soon_as_a_new_one_starts(store: Store, record: RunRecord) -> None:
    committer, zombie, parts = begun(store, record)
    committer.publish(record, 0, parts)
    assert committer.start(record) == 1
    assert visible_steps(store) == [0]
    before = tree(store, keep=lambda path: path.startswith(("manifests/", "tables/")))
    zombie.add(*make_rows(np.random.default_rng(10), 10)[0])
    parts, final = zombie.flush(), zombie.finish()
    for publication in (
        lambda: committer.publish(record, 0, parts),
        lambda: committer.finish(record, 0, final),
        lambda: committer.fail(record, 0, "late"),
    ):
        with pytest.raises(StaleAttemptError, match="attempt 0 is stale"):
            publication()
    assert tree(store, keep=lambda path: path.startswith(("manifests/", "tables/"))) == before


def test_a_finished_run_stays_as_it_is(store: Store, record: RunRecord) -> None:
    committer = Committer(store)
    committer.finish(record, committer.start(record), RunWriter(store, "run-1", 0).finish())
    before = tree(store)
    late = RunWriter(store, "run-1", 1)
    for publication in (
        lambda: committer.start(record),
        lambda: committer.publish(record, 1, ()),
        lambda: committer.fail(record, 1, "late"),
        lambda: committer.finish(record, 1, late.finish()),
    ):
        with pytest.raises(StaleAttemptError, match="is done"):
            publication()
    committer.sweep()
    assert tree(store) == before


def test_a_failed_run_keeps_its_rows_and_may_be_taken_up_again(store: Store, record: RunRecord) -> None:
    committer, _, parts = begun(store, record)
    committer.publish(record, 0, parts)
    committer.fail(record, 0, "ValueError: task 3 fell over")
    row = Results(store).table(Table.RUNS).to_pylist()[0]
    assert (row["status"], row["error"]) == ("failed", "ValueError: task 3 fell over")
    assert visible_steps(store) == [0]
    assert committer.start(record) == 1
    committer.finish(record, 1, RunWriter(store, "run-1", 1, parts).finish())
    row = Results(store).table(Table.RUNS).to_pylist()[0]
    assert (row["status"], row["error"]) == ("done", None)
    assert visible_steps(store) == [0]


def test_what_is_not_there_or_not_whole_is_never_published(store: Store, record: RunRecord) -> None:
    committer = Committer(store)
    attempt = committer.start(record)
    before = tree(store)
    part = PartFile(Table.EPISODES, "staging/run-1/attempt-000/part-00000/episodes.parquet", 1, "0")
    with pytest.raises(FileNotFoundError, match="part-00000"):
        committer.publish(record, attempt, [part])
    final = RunWriter(store, "run-1", attempt).finish()
    with pytest.raises(ValueError, match="one file for each"):
        committer.finish(record, attempt, final[1:])
    store.write_bytes(final[-1].path, b"torn")
    with pytest.raises(ValueError, match=r"final/teacher_log\.parquet is damaged"):
        committer.finish(record, attempt, final)
    assert tree(store, keep=lambda path: path.startswith("manifests/")).items() <= before.items()


def test_attempts_are_rows_by_number(store: Store) -> None:
    committer = Committer(store)

    def attempt(number: int, outcome: AttemptOutcome) -> AttemptRecord:
        began = datetime(2026, 1, 2, 3, 4, number, tzinfo=UTC)
        return AttemptRecord("run-1", number, began, 1.5, 800.0, "host", "{}", outcome)

    for number, outcome in ((1, "lost"), (0, "stopped"), (1, "done")):
        committer.record_attempt(attempt(number, AttemptOutcome(outcome)))
    rows = Results(store).table(Table.ATTEMPTS, run_ids=["run-1"]).to_pylist()
    assert [(row["attempt"], row["outcome"]) for row in rows] == [(0, "stopped"), (1, "done")]
    assert rows[1]["started_at"] == datetime(2026, 1, 2, 3, 4, 1, tzinfo=UTC)
    assert len(Results(store).table(Table.ATTEMPTS, run_ids=["run-2"])) == 0


def test_an_attempt_has_a_time_zone() -> None:
    with pytest.raises(ValueError, match="time zone"):
        AttemptRecord("run-1", 0, datetime(2026, 1, 2), 1.0, 1.0, "h", "{}", AttemptOutcome.DONE)


def test_cells_of_a_campaign_add_up_and_follow_their_run(store: Store) -> None:
    committer = Committer(store)
    teachers = {"a": "riac", "b": "adr", "c": "adr", "d": "random"}
    a, b, c, d = (make_cell(run_id, teacher=teacher) for run_id, teacher in teachers.items())
    committer.write_cells("stumps", [a, b])
    committer.write_cells("stumps", [c, d])
    committer.write_cells("parkour", [b])
    rows = Results(store).table(Table.CELLS, columns=["campaign", "teacher", "run_id"]).to_pylist()
    assert [tuple(row.values()) for row in rows] == [
        ("parkour", "adr", "b"),
        ("stumps", "adr", "c"),
        ("stumps", "random", "d"),
        ("stumps", "riac", "a"),
    ]
    with pytest.raises(ValueError, match="missing: seed"):
        committer.write_cells("stumps", [{k: v for k, v in a.items() if k != "seed"}])


def test_a_sweep_takes_what_zombies_left_of_finished_runs_only(store: Store) -> None:
    for run_id in ("run-1", "run-2"):
        committer, _, _ = begun(store, make_record(run_id))
    committer.finish(make_record("run-1"), 0, RunWriter(store, "run-1", 0).finish())
    store.write_bytes("staging/run-1/attempt-000/part-00009/episodes.parquet", b"late")
    committer.sweep()
    assert store.files("staging") == ("staging/run-2/attempt-000/part-00000/evaluations.parquet",)

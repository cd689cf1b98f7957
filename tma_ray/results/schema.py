"""The tables of a results root: their columns, types and units.

A column that may be absent says so by being nullable; every other one is required in every row. A column
that is added later is nullable or names a default, which is what rows of older files have there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import StrEnum
from typing import Any, Final

import pyarrow as pa

SCHEMA_VERSION: Final = 1
"""Version of tables, manifests and layout together; raise it when any of them changes its meaning.

Columns and fields may be added without that: see `default_of`.
"""

VERSION_KEY: Final = "tma_ray.schema_version"
"""Under which the metadata of every file of a table names the version."""


class Table(StrEnum):
    """The tables of a results root."""

    RUNS = "runs"
    ATTEMPTS = "attempts"
    CELLS = "cells"
    EVALUATIONS = "evaluations"
    TRAINING = "training"
    EPISODES = "episodes"
    CURRICULUM = "curriculum"
    TEACHER_LOG = "teacher_log"


DATA_TABLES: Final = (
    Table.EVALUATIONS,
    Table.TRAINING,
    Table.EPISODES,
    Table.CURRICULUM,
    Table.TEACHER_LOG,
)
"""What a run writes itself; the other tables are about runs and are written by the committer."""

_ID = pa.dictionary(pa.int32(), pa.string())
_TASK = pa.list_(pa.field("element", pa.float32(), nullable=False))
_VECTOR = pa.list_(pa.field("element", pa.float64(), nullable=False))
_GAUSSIAN = pa.struct(
    [("weight", pa.float64()), ("mean", _VECTOR), ("covariance", pa.list_(pa.field("element", _VECTOR)))]
)
_BOX = pa.struct([("low", _VECTOR), ("high", _VECTOR), ("score", pa.float64())])


DEFAULT: Final = b"default"
"""Key of a column's metadata: JSON of what rows have that were written before there was the column."""


def default_of(field: pa.Field) -> Any:
    """Returns what rows have in a column that did not exist when they were written.

    Raises:
        KeyError: it has always existed: it is neither nullable, nor does it name a default.
    """
    metadata = field.metadata or {}
    if DEFAULT in metadata:
        return json.loads(metadata[DEFAULT])
    if field.nullable:
        return None
    raise KeyError(field.name)


def _column(
    name: str, kind: pa.DataType, unit: str = "", *, nullable: bool = False, default: Any = None
) -> pa.Field:
    metadata = {"unit": unit} if unit else {}
    if default is not None:
        metadata[DEFAULT.decode()] = json.dumps(default)
    return pa.field(name, kind, nullable=nullable, metadata=metadata or None)


_RUN_ID = _column("run_id", _ID)
_STEP = _column("step", pa.int64(), "environment steps since the run began")
_EPISODE = _column("episode", pa.int64(), "episodes since the run began")
_RETURN = _column("episodic_return", pa.float64(), "undiscounted sum of rewards")
_LENGTH = _column("length", pa.int32(), "environment steps")
_SEED = _column("seed", pa.int64())
_CELL = tuple(
    _column(name, _ID)
    for name in ("environment", "challenge", "embodiment", "student", "teacher", "expert_knowledge")
)

_COLUMNS: Final[Mapping[Table, tuple[pa.Field, ...]]] = {
    Table.RUNS: (
        _RUN_ID,
        _column("spec", pa.string(), "JSON"),
        *_CELL,
        _column("test_set", _ID),
        _column("steps", pa.int64(), "environment steps, the budget"),
        _SEED,
        _column("physics_version", pa.int32()),
        _column("status", _ID),
        _column("error", pa.string(), nullable=True),
        _column("benchmark_version", pa.int32(), nullable=True),
    ),
    Table.ATTEMPTS: (
        _RUN_ID,
        _column("attempt", pa.int32()),
        _column("started_at", pa.timestamp("us", tz="UTC")),
        _column("wall_seconds", pa.float64(), "s"),
        _column("env_steps_per_second", pa.float64(), "1/s"),
        _column("host", _ID),
        _column("fingerprint", _ID, "JSON"),
        _column("outcome", _ID),
    ),
    Table.CELLS: (_column("campaign", _ID), _column("experiment", _ID), *_CELL, _SEED, _RUN_ID),
    Table.EVALUATIONS: (
        _RUN_ID,
        _STEP,
        _column("test_set", _ID),
        _column("task_index", pa.int32()),
        _column("task", _TASK, "task units of the environment"),
        _RETURN,
        _LENGTH,
    ),
    Table.TRAINING: (
        _RUN_ID,
        _STEP,
        _column("episodes", pa.int64(), "episodes of the window"),
        _column("mean_return", pa.float64(), "undiscounted sum of rewards"),
        _column("std_return", pa.float64(), "undiscounted sum of rewards"),
        _column("mean_length", pa.float64(), "environment steps"),
        _column("success_share", pa.float64(), "share in [0, 1]"),
    ),
    Table.EPISODES: (
        _RUN_ID,
        _STEP,
        _EPISODE,
        _column("task", _TASK, "task units, as the teacher chose it"),
        _column("world_task", _TASK, "task units, as the world was built if shuffled", nullable=True),
        _RETURN,
        _LENGTH,
        _column("success", pa.bool_()),
        _column("trains", pa.bool_(), default=True),
    ),
    Table.CURRICULUM: (
        _RUN_ID,
        _STEP,
        _column("sample", pa.int32()),
        _column("task", _TASK, "task units, as the teacher chose it"),
    ),
    Table.TEACHER_LOG: (
        _RUN_ID,
        _STEP,
        _EPISODE,
        _column("gaussians", pa.list_(pa.field("element", _GAUSSIAN)), "task units"),
        _column("boxes", pa.list_(pa.field("element", _BOX)), "task units"),
        _column("scalars", pa.map_(pa.string(), pa.float64())),
    ),
}

SCHEMAS: Final[Mapping[Table, pa.Schema]] = {
    table: pa.schema(columns, metadata={"tma_ray.table": table, VERSION_KEY: str(SCHEMA_VERSION)})
    for table, columns in _COLUMNS.items()
}
"""Columns in order; field metadata "unit" tells what the numbers count."""

"""Tables of a results root, with their columns, types and units.

Columns are required unless nullable. Columns added later are nullable or have a default for older rows.
"""

import json
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

SCHEMA_VERSION: Final = 1
"""Version of tables, manifests and layout, raised when meanings change, not for additions (`default_of`)."""

VERSION_KEY: Final = "tma_ray.schema_version"  # key of the schema version in a file's metadata


class Table(StrEnum):
    """Names of the tables of a results root."""

    RUNS = "runs"
    ATTEMPTS = "attempts"
    CELLS = "cells"
    EVALUATIONS = "evaluations"
    TRAINING = "training"
    EPISODES = "episodes"
    CURRICULUM = "curriculum"
    TEACHER_LOG = "teacher_log"


DATA_TABLES: Final = (Table.EVALUATIONS, Table.TRAINING, Table.EPISODES, Table.CURRICULUM, Table.TEACHER_LOG)
"""Tables written by runs. The committer writes the other ones, which are about runs."""

_ID = pa.dictionary(pa.int32(), pa.string())
_TASK = pa.list_(pa.field("element", pa.float32(), nullable=False))
_VECTOR = pa.list_(pa.field("element", pa.float64(), nullable=False))
_GAUSSIAN = pa.struct(
    [("weight", pa.float64()), ("mean", _VECTOR), ("covariance", pa.list_(pa.field("element", _VECTOR)))]
)
_BOX = pa.struct([("low", _VECTOR), ("high", _VECTOR), ("score", pa.float64())])


DEFAULT: Final = b"default"  # metadata key of a column's default for older rows (JSON)


def default_of(field: pa.Field) -> Any:
    """Return a column's default for rows older than the column, or raise a KeyError if it has none."""
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
        _column("mastery_threshold", pa.float64(), "undiscounted sum of rewards", nullable=True),
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
"""Schema of each table, with units in the metadata "unit" of fields."""


def schema_version(file: Any) -> int:
    """Return an open Parquet file's schema version, or raise a KeyError or ValueError if it has none."""
    return int((pq.read_schema(file).metadata or {})[VERSION_KEY.encode()])


def to_arrow(table: Table, schema: pa.Schema, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Convert `rows` to an Arrow table, filling in missing nullable columns and defaults.

    Raises:
        ValueError: if a column is missing, unknown, or of a wrong type.
    """
    defaults = {f.name: default_of(f) for f in schema if f.nullable or DEFAULT in (f.metadata or {})}
    names, needed = set(schema.names), [f.name for f in schema if not f.nullable and f.name not in defaults]
    for row in rows:
        if not names.issuperset(row) or any(row.get(name) is None for name in needed):
            unknown = [name for name in row if name not in names]
            missing = [name for name in needed if row.get(name) is None]
            raise ValueError(
                f"a row of {table} has the columns {', '.join(schema.names)}; "
                f"missing: {', '.join(missing) or 'none'}; unknown: {', '.join(unknown) or 'none'}"
            )
    columns = [
        _to_array(table, field, [row.get(field.name, defaults.get(field.name)) for row in rows])
        for field in schema
    ]
    return pa.Table.from_arrays(columns, schema=schema)


def completed(schema: pa.Schema, names: Sequence[str], rows: pa.Table) -> pa.Table:
    """Return `rows` of a file with the columns `names` of `schema`, filling in columns added later.

    Raises:
        KeyError: if a required column is missing.
        pa.ArrowException: if a column has another type.
    """
    columns = []
    for name in names:
        field = schema.field(name)
        if name in rows.column_names:
            column = rows.column(name)
            columns.append(column if column.type == field.type else column.cast(field.type))
        else:
            value = pa.array([default_of(field)], field.type)
            columns.append(value.take(pa.array(np.zeros(len(rows), np.int32))))
    return pa.Table.from_arrays(columns, schema=selected(schema, names))


def selected(schema: pa.Schema, names: Sequence[str]) -> pa.Schema:
    """Return the schema of the columns `names`, in this order."""
    return pa.schema([schema.field(name) for name in names], schema.metadata)


def _to_array(table: Table, field: pa.Field, values: list[Any]) -> pa.Array:
    try:
        if pa.types.is_integer(field.type):
            return pa.array(values).cast(field.type)  # rejects 1.5, which pa.array would truncate
        return pa.array(values, type=field.type)
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise ValueError(f"{table}.{field.name} holds values of type {field.type}: {error}") from error

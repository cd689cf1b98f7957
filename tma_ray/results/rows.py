"""Rows to Arrow tables of today's columns: from names and values, or from files of other columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from tma_ray.results.schema import Table, default_of
from tma_ray.tasks import TeacherUpdate


def teacher_log_row(step: int, episode: int, update: TeacherUpdate) -> dict[str, Any]:
    """Returns the row of the teacher log that tells of an update after `episode`, at `step`."""
    return {
        "step": step,
        "episode": episode,
        "gaussians": [
            {"weight": part.weight, "mean": part.mean.tolist(), "covariance": part.covariance.tolist()}
            for part in update.gaussians
        ],
        "boxes": [
            {"low": box.low.tolist(), "high": box.high.tolist(), "score": box.score} for box in update.boxes
        ],
        "scalars": update.scalars,
    }


def to_arrow(table: Table, schema: pa.Schema, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Returns `rows` with the columns of `schema`; one that is nullable or has a default may be left out.

    Raises:
        ValueError: a column missing, unknown, or of a wrong type; the message names table and column.
    """
    defaults = _defaults(schema)
    known, needed = set(schema.names), [f.name for f in schema if not f.nullable and f.name not in defaults]
    for row in rows:
        if not known.issuperset(row) or any(row.get(name) is None for name in needed):
            raise _wrong_names(table, schema, {**defaults, **row})
    columns = [
        _to_array(table, field, [row.get(field.name, defaults.get(field.name)) for row in rows])
        for field in schema
    ]
    return pa.Table.from_arrays(columns, schema=schema)


def completed(schema: pa.Schema, names: Sequence[str], rows: pa.Table) -> pa.Table:
    """Returns `rows` of a file with the columns `names` of `schema`, whatever columns the file has.

    A column that came into the schema later is null or has the default that the schema names; one that this
    schema does not know is left out.

    Raises:
        KeyError: a column is missing that has always been there.
        pa.ArrowException: a column is of another type.
    """
    columns = []
    for name in names:
        field = schema.field(name)
        if name in rows.column_names:
            columns.append(_typed(rows.column(name), field.type))
        else:
            value = pa.array([default_of(field)], field.type)
            columns.append(value.take(pa.array(np.zeros(len(rows), np.int32))))
    return pa.Table.from_arrays(columns, schema=selected(schema, names))


def selected(schema: pa.Schema, names: Sequence[str]) -> pa.Schema:
    """Returns the columns `names` of `schema`, in their order."""
    return pa.schema([schema.field(name) for name in names], schema.metadata)


def _typed(column: pa.ChunkedArray, kind: pa.DataType) -> pa.ChunkedArray:
    return column if column.type == kind else column.cast(kind)


def _defaults(schema: pa.Schema) -> dict[str, Any]:
    """Returns the defaults that columns of `schema` name."""
    found = {}
    for field in schema:
        try:
            found[field.name] = default_of(field)
        except KeyError:
            continue
    return found


def _wrong_names(table: Table, schema: pa.Schema, row: Mapping[str, Any]) -> ValueError:
    unknown = [name for name in row if name not in schema.names]
    missing = [field.name for field in schema if not field.nullable and row.get(field.name) is None]
    return ValueError(
        f"a row of {table} has the columns {', '.join(schema.names)}; "
        f"missing: {', '.join(missing) or 'none'}; unknown: {', '.join(unknown) or 'none'}"
    )


def _to_array(table: Table, field: pa.Field, values: list[Any]) -> pa.Array:
    try:
        if pa.types.is_integer(field.type):
            return pa.array(values).cast(field.type)  # refuses 1.5, which pa.array would cut to 1
        return pa.array(values, type=field.type)
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise ValueError(f"{table}.{field.name} holds values of type {field.type}: {error}") from error

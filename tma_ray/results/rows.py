"""Rows by column name to Arrow, refusing by name what does not fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa

from tma_ray.results.schema import Table
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
    """Returns `rows` with the columns of `schema`; a nullable one may be left out.

    Raises:
        ValueError: a column missing, unknown, or of a wrong type; the message names table and column.
    """
    for row in rows:
        _check_names(table, schema, row)
    columns = [_column(table, field, [row.get(field.name) for row in rows]) for field in schema]
    return pa.Table.from_arrays(columns, schema=schema)


def _check_names(table: Table, schema: pa.Schema, row: Mapping[str, Any]) -> None:
    unknown = [name for name in row if name not in schema.names]
    missing = [field.name for field in schema if not field.nullable and row.get(field.name) is None]
    if unknown or missing:
        raise ValueError(
            f"a row of {table} has the columns {', '.join(schema.names)}; "
            f"missing: {', '.join(missing) or 'none'}; unknown: {', '.join(unknown) or 'none'}"
        )


def _column(table: Table, field: pa.Field, values: list[Any]) -> pa.Array:
    try:
        if pa.types.is_integer(field.type):
            return pa.array(values).cast(field.type)  # refuses 1.5, which pa.array would cut to 1
        return pa.array(values, type=field.type)
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise ValueError(f"{table}.{field.name} holds values of type {field.type}: {error}") from error

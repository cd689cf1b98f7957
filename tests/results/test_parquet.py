import io

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from results_examples import make_rows

from tma_ray.results import DATA_TABLES, SCHEMAS, Table
from tma_ray.results.parquet import decode, encode
from tma_ray.results.rows import to_arrow


def rows_of(table: Table) -> pa.Table:
    rng = np.random.default_rng(0)
    batches = [dict(make_rows(rng, step))[table] for step in range(0, 90, 10)]
    added = [row for batch in batches for row in batch]
    return to_arrow(table, SCHEMAS[table], [{"run_id": "run-1", **row} for row in added])


@pytest.mark.parametrize("table", DATA_TABLES)
def test_rows_come_back_with_types_and_units(table: Table) -> None:
    rows = rows_of(table)
    back = decode(encode(table, rows))
    assert back.schema.equals(SCHEMAS[table])
    assert back.to_pylist() == rows.to_pylist()
    assert back.schema.metadata[b"tma_ray.schema_version"] == b"1"
    assert back.schema.field("step").metadata[b"unit"].startswith(b"environment steps")


@pytest.mark.parametrize("table", Table)
def test_a_table_without_rows_keeps_its_columns(table: Table) -> None:
    back = decode(encode(table, SCHEMAS[table].empty_table()))
    assert back.schema.equals(SCHEMAS[table])
    assert len(back) == 0


@pytest.mark.parametrize("table", DATA_TABLES)
def test_bytes_do_not_depend_on_chunks_or_dictionaries(table: Table) -> None:
    rows = rows_of(table)
    pieces = [rows.slice(start, 2) for start in range(0, len(rows), 2)]
    reversed_ids = pa.DictionaryArray.from_arrays(
        pa.array([1] * len(rows), pa.int32()), pa.array(["unused", "run-1"])
    )
    assert encode(table, pa.concat_tables(pieces)) == encode(table, rows)
    assert encode(table, rows.set_column(0, "run_id", reversed_ids)) == encode(table, rows)


def test_numbers_take_the_encodings_that_suit_them() -> None:
    metadata = pq.read_metadata(io.BytesIO(encode(Table.EPISODES, rows_of(Table.EPISODES))))
    group = metadata.row_group(0)
    columns = {group.column(i).path_in_schema: group.column(i) for i in range(group.num_columns)}
    assert {column.compression for column in columns.values()} == {"ZSTD"}
    assert "DELTA_BINARY_PACKED" in columns["step"].encodings
    assert "BYTE_STREAM_SPLIT" in columns["episodic_return"].encodings
    assert "BYTE_STREAM_SPLIT" in columns["task.list.element"].encodings
    assert "RLE_DICTIONARY" in columns["run_id"].encodings


def test_a_flipped_bit_is_noticed() -> None:
    data = bytearray(encode(Table.EPISODES, rows_of(Table.EPISODES)))
    data[40] ^= 1
    with pytest.raises((OSError, pa.ArrowException)):
        decode(bytes(data))

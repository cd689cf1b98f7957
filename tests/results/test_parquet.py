import io
import math
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from results_examples import make_rows

from tma_ray.results import DATA_TABLES, SCHEMAS, Table, parquet
from tma_ray.results.parquet import decode, encode
from tma_ray.results.schema import to_arrow


def rows_of(table: Table) -> pa.Table:
    rng = np.random.default_rng(0)
    batches = [dict(make_rows(rng, step))[table] for step in range(0, 90, 10)]
    added = [row for batch in batches for row in batch]
    return to_arrow(table, SCHEMAS[table], [{"run_id": "run-1", **row} for row in added])


@pytest.mark.parametrize("table", DATA_TABLES)
def test_rows_come_back_with_types_and_units(table: Table) -> None:
    rows = rows_of(table)
    back = decode(table, encode(table, rows))
    assert back.schema.equals(SCHEMAS[table])
    assert back.to_pylist() == rows.to_pylist()
    assert back.schema.metadata[b"tma_ray.schema_version"] == b"1"
    assert back.schema.field("step").metadata[b"unit"].startswith(b"environment steps")


@pytest.mark.parametrize("table", Table)
def test_a_table_without_rows_keeps_its_columns(table: Table) -> None:
    back = decode(table, encode(table, SCHEMAS[table].empty_table()))
    assert back.schema.equals(SCHEMAS[table])
    assert len(back) == 0


@pytest.mark.parametrize("table", DATA_TABLES)
def test_bytes_do_not_depend_on_chunks_or_dictionaries(table: Table) -> None:
    rows = rows_of(table)
    pieces = [rows.slice(start, 2) for start in range(0, len(rows), 2)]
    ids = pa.array(["unused", "run-1"])
    reversed_ids = pa.DictionaryArray.from_arrays(pa.array([1] * len(rows), pa.int32()), ids)
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
        decode(Table.EPISODES, bytes(data))


def episodes(run_id: str, count: int) -> pa.Table:
    rows = [
        {"run_id": run_id, "step": step, "episode": step, "task": [0.0], "world_task": None}
        | {"episodic_return": math.nan if step == 1 else step / 3, "length": 1, "success": True}
        for step in range(count)
    ]
    return to_arrow(Table.EPISODES, SCHEMAS[Table.EPISODES], rows)


def test_rows_of_many_runs_are_read_back_run_by_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet, "ROW_GROUP_ROWS", 5)
    parts = [episodes(name, count) for name, count in zip("abcdef", (2, 3, 1, 12, 0, 2), strict=True)]
    data = parquet.encode_together(Table.EPISODES, iter(parts))
    groups = pq.ParquetFile(pa.BufferReader(data)).metadata
    assert [groups.row_group(place).num_rows for place in range(groups.num_row_groups)] == [5, 1, 5, 5, 2, 2]
    first = 0
    for part in parts:
        rows = parquet.decode_rows(Table.EPISODES, pa.BufferReader(data), first, len(part), part.column_names)
        assert parquet.same_rows(Table.EPISODES, rows, part)
        first += len(part)
    with pytest.raises(IndexError, match="it has 20 rows, not 21"):
        parquet.decode_rows(Table.EPISODES, pa.BufferReader(data), 19, 2, ["step"])


def test_rows_are_the_same_by_value_and_order() -> None:
    rows = episodes("a", 3)
    assert parquet.same_rows(Table.EPISODES, rows, episodes("a", 3))
    for others in (episodes("b", 3), rows.slice(1), rows.take([1, 0, 2])):
        assert not parquet.same_rows(Table.EPISODES, rows, others)


SCRIPT = """
import sys
from tma_ray.support.import_hacks import skip_pandas
skip_pandas()
import pyarrow as pa
table = pa.table({"step": pa.array([1, 2]), "name": pa.array(["a", None])})
assert "pandas" not in sys.modules
frame = table.to_pandas()
assert frame.step.tolist() == [1, 2]
import pandas as pd
assert pa.Table.from_pandas(pd.DataFrame({"step": [3]})).to_pylist() == [{"step": 3}]
skip_pandas()
assert pa.array(pd.Series([1.0, float("nan")])).null_count == 1
"""


def test_lists_become_columns_without_pandas() -> None:
    subprocess.run([sys.executable, "-c", SCRIPT], check=True)

"""What others made is never trusted with memory or with other folders: sizes and links are checked first."""

import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from results_examples import make_record

from tma_ray.cli import main
from tma_ray.embodiments import load_embodiment
from tma_ray.results import Committer, Results, RunStatus, Table
from tma_ray.results.layout import table_path
from tma_ray.results.manifest import MOST_RUN_ROWS, Manifest, PartFile
from tma_ray.results.parquet import MOST_TABLE_ROWS, decode, opened, unpacked_sizes
from tma_ray.results.schema import SCHEMAS
from tma_ray.support.decoding import DamagedFileError, DamagedFileWarning, load_npz
from tma_ray.tasks import TestSet


def repeated(table: Table, rows: int) -> bytes:
    """A small file of very many equal rows."""
    schema, sink = SCHEMAS[table], io.BytesIO()
    arrays = []
    for field in schema:
        kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
        value = {"string": "x", "int64": 0, "int32": 0}.get(str(kind))
        arrays.append(pa.repeat(pa.scalar(value, kind), rows).cast(field.type))
    pq.write_table(pa.table(arrays, schema=schema), sink, compression="zstd")
    return sink.getvalue()


def npy(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    """The header of an array, and nothing else."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": kind, "fortran_order": False, "shape": shape})
    return file.getvalue()


def test_an_archive_that_inflates_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("w1.npy", npy((2**20,)) + bytes(2**23))
    assert load_npz(path)["w1"].shape == (2**20,)
    with pytest.raises(ValueError, match=r"would take 8,388,.* bytes"):
        load_npz(path, 2**20)
    for shape in ((10**12,), (10**6, 10**6), (1,)):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("w1.npy", npy(shape))
        with pytest.raises(ValueError, match=r"array 'w1' of .* is damaged"):
            load_npz(path)


def test_a_table_of_repeated_rows_is_named_and_left_out(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(MOST_TABLE_ROWS, Table.CELLS, 100_000)
    root = Committer.open(tmp_path / "root").store
    root.write_bytes(table_path(Table.CELLS, "bomb"), repeated(Table.CELLS, 100_001))
    with pytest.warns(DamagedFileWarning, match=r"cells/bomb\.parquet was left out: it claims 100,001 rows"):
        assert len(Results(root).table(Table.CELLS)) == 0
    assert main(["status", str(tmp_path / "root")]) == 0
    assert "cells/bomb.parquet" in capsys.readouterr().err


def test_rows_are_counted_before_they_are_read() -> None:
    data = repeated(Table.CELLS, 1_000)
    with pytest.raises(DamagedFileError, match="it has 1000 rows, but its manifest says 5"):
        decode(Table.CELLS, data, count=5)


def of_large_texts(table: Table, column: str, rows: int, stored: str) -> bytes:
    """A small file whose rows have a text of 1 MB each, stored once or compressed to next to nothing."""
    text = "x" * 2**20
    texts = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int32)), pa.array([text]))
    columns = {
        field.name: pa.array(["x"] * rows) if "string" in str(field.type) else pa.array([0] * rows)
        for field in SCHEMAS[table]
    }
    columns[column] = texts if stored == "dictionary" else pa.array([f"{text}{i}" for i in range(rows)])
    options = {} if stored == "dictionary" else {"use_dictionary": False, "column_encoding": {column: stored}}
    sink = io.BytesIO()
    pq.write_table(pa.table(columns), sink, compression="zstd", store_schema=False, **options)
    return sink.getvalue()


@pytest.mark.parametrize(
    ("table", "column", "rows", "stored"),
    [
        (Table.RUNS, "spec", 1_500, "dictionary"),
        (Table.CELLS, "experiment", 100, "PLAIN"),
        (Table.CELLS, "experiment", 100, "DELTA_BYTE_ARRAY"),
        (Table.CELLS, "experiment", 100, "DELTA_LENGTH_BYTE_ARRAY"),
    ],
)
def test_tables_that_would_fill_memory_are_refused(table: Table, column: str, rows: int, stored: str) -> None:
    data = of_large_texts(table, column, rows, stored)
    assert len(data) < 2**17
    before = pa.default_memory_pool().max_memory()
    with pytest.raises(DamagedFileError, match=f"its {rows:,} rows of {table} would take more than"):
        decode(table, data)
    assert pa.default_memory_pool().max_memory() == before


def test_ids_that_are_stored_once_are_kept_once() -> None:
    found = decode(Table.CELLS, of_large_texts(Table.CELLS, "experiment", 1_500, "dictionary"))
    assert len(found) == 1_500
    assert found.nbytes < 2**22


def test_what_the_end_of_a_file_says_of_its_pages_is_not_believed() -> None:
    data = of_large_texts(Table.RUNS, "spec", 1_500, "dictionary")
    file, source = opened(data), pa.BufferReader(data)
    sizes = list(unpacked_sizes(file, source, [0], ["spec"], ()))
    claimed = file.metadata.row_group(0).column(SCHEMAS[Table.RUNS].names.index("spec"))
    assert sum(sizes) > 1_500 * 2**20 > 100 * claimed.total_uncompressed_size


@pytest.mark.parametrize("place", ["a pipe", "holes"])
@pytest.mark.parametrize(
    ("name", "read"),
    [("tests.csv", TestSet.from_csv), ("body.toml", load_embodiment), ("weights.npz", load_npz)],
)
def test_no_reader_waits_for_a_pipe_or_reads_holes(tmp_path, name, read, place):
    path = tmp_path / name
    if place == "a pipe":
        os.mkfifo(path)
    else:
        path.touch()
        os.truncate(path, 300 * 2**30)
    with pytest.raises(ValueError, match=r"a named pipe lies in its place|it has 322,122,547,200 bytes"):
        read(path)


def test_a_manifest_that_lists_more_rows_than_any_run_has_is_refused() -> None:
    path = table_path(Table.EPISODES, "run")
    files = (PartFile(Table.EPISODES, path, MOST_RUN_ROWS + 1, "0" * 64),)
    manifest = Manifest(make_record("run"), RunStatus.DONE, 0, files)
    with pytest.raises(ValueError, match="more than any run has"):
        manifest.check("run")

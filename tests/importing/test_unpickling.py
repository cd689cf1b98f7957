"""Pickles of arrays and containers are read; every other one is refused, and nothing of it runs."""

import copyreg
import os
import pickle
import sys
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile_pickles import HARMFUL, HARMS, Calls, Harm, history_with, shell

from tma_ray.importing import RefusedPickleError, load_pickle
from tma_ray.importing.unpickling import _GRANTED

HISTORY = {
    "vectors": [np.array([0.5, 2.0], dtype=np.float32), np.array([1.0, -3.0], dtype=np.float32)],
    "matrix": np.asfortranarray(np.arange(12.0).reshape(3, 4)),
    "big endian": np.arange(3, dtype=">i4"),
    "empty": np.zeros((0, 2)),
    "flags": np.array([True, False]),
    "number": np.float32(1.5),
    "whole": np.int64(-3),
    "true": np.bool_(True),
    "nested": (1, [2.5, {"a": None}], {"x", "y"}, frozenset({1, 2})),
    "bytes": (b"", b"\xff\x00"),
}


def same(found: Any, expected: Any) -> bool:
    if isinstance(expected, np.ndarray):
        kinds = isinstance(found, np.ndarray) and found.dtype.newbyteorder(
            "="
        ) == expected.dtype.newbyteorder("=")
        return kinds and found.shape == expected.shape and bool(np.array_equal(found, expected))
    if isinstance(expected, list | tuple):
        return type(found) is type(expected) and all(map(same, found, expected))
    return bool(found == expected)


def traced(harm: Harm, tmp_path: Path) -> tuple[Path, Path]:
    """Returns the file of the pickle and that of its trace."""
    trace, path = tmp_path / "trace", tmp_path / "env_params_save.pkl"
    path.write_bytes(harm(str(trace)))
    return path, trace


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("core", ["numpy.core", "numpy._core"])
def test_arrays_numbers_and_containers_of_every_protocol(tmp_path: Path, protocol: int, core: str) -> None:
    data = pickle.dumps(HISTORY, protocol=protocol)
    if protocol < 4:  # later ones write how long a name is
        data = data.replace(b"numpy._core", core.encode())
    path = tmp_path / "history.pkl"
    path.write_bytes(data)
    found = load_pickle(path)
    assert list(found) == list(HISTORY)
    assert all(same(found[name], value) for name, value in HISTORY.items())


@pytest.mark.parametrize("module", ["numpy.core.multiarray", "numpy._core.multiarray"])
def test_both_spellings_of_numpy_in_protocol_4(tmp_path: Path, module: str) -> None:
    spelled = b"\x8c" + bytes([len(module)]) + module.encode()
    written = b"\x8c\x16numpy._core.multiarray"
    data = pickle.dumps(np.arange(3.0), protocol=4).replace(written, spelled)
    frame = len(data) - 11
    (tmp_path / "a.pkl").write_bytes(data[:3] + frame.to_bytes(8, "little") + data[11:])
    assert load_pickle(tmp_path / "a.pkl").tolist() == [0, 1, 2]


def test_an_array_as_python_2_wrote_it(tmp_path: Path) -> None:
    data = (
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR(I1\n(I2\ntcnumpy\ndtype\n"
        b"(S'u1'\nI0\nI1\ntR(I3\nS'|'\nNNNI-1\nI-1\nI0\ntbI00\nS'\\x07\\xff'\ntb."
    )
    (tmp_path / "a.pkl").write_bytes(data)
    assert load_pickle(tmp_path / "a.pkl").tolist() == [7, 255]


@pytest.mark.parametrize("harm", HARMFUL, ids=lambda harm: harm.__name__)
def test_the_hostile_pickles_do_harm_where_nobody_stops_them(tmp_path: Path, harm: Harm) -> None:
    path, trace = traced(harm, tmp_path)
    with suppress(Exception):
        value = pickle.loads(path.read_bytes())
        np.load(f"{trace}.npy", allow_pickle=True) if harm.__name__ == "numpy_load" else value
    assert trace.exists()


@pytest.mark.parametrize("harm", HARMS, ids=lambda harm: harm.__name__)
def test_hostile_pickles_are_refused_by_name_and_leave_no_trace(tmp_path: Path, harm: Harm) -> None:
    path, trace = traced(harm, tmp_path)
    before = set(tmp_path.iterdir())
    modules = set(sys.modules)
    with pytest.raises(RefusedPickleError) as caught:
        load_pickle(path)
    assert str(path) in str(caught.value)
    assert "refused" in str(caught.value)
    assert not trace.exists()
    assert set(tmp_path.iterdir()) == before
    assert not {
        name for name in set(sys.modules) - modules if name.startswith(("torch", "pandas", "numpy.f2py"))
    }


def test_the_message_names_what_was_asked_for(tmp_path: Path) -> None:
    path, _ = traced(shell, tmp_path)
    with pytest.raises(RefusedPickleError, match=r"posix\.system.*nothing of it was run"):
        load_pickle(path)


def test_a_cached_extension_code_is_no_way_in(tmp_path: Path) -> None:
    copyreg.add_extension("posix", "system", 0xF0)
    try:
        data = b"\x80\x02\x82\xf0(X\x04\x00\x00\x00truetR."
        assert pickle.loads(data) == 0  # which puts it into the cache
        (tmp_path / "a.pkl").write_bytes(data)
        with pytest.raises(RefusedPickleError, match="extension code"):
            load_pickle(tmp_path / "a.pkl")
    finally:
        copyreg.remove_extension("posix", "system", 0xF0)


def test_names_are_granted_for_arrays_sets_and_bytes_only() -> None:
    assert {name for _, name in _GRANTED} == {
        *("ndarray", "dtype", "_reconstruct", "scalar", "_frombuffer", "encode", "bytes", "set", "frozenset")
    }


def test_what_was_refused_changes_nothing_for_the_next(tmp_path: Path) -> None:
    for harm in HARMS:
        (tmp_path / "a.pkl").write_bytes(harm(str(tmp_path / "trace")))
        with pytest.raises(RefusedPickleError):
            load_pickle(tmp_path / "a.pkl")
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(HISTORY))
    assert same(load_pickle(tmp_path / "a.pkl")["nested"], HISTORY["nested"])
    assert np.dtype("f8").byteorder == "="


@pytest.mark.parametrize(
    "value",
    [OrderedDict(a=1), complex(1, 2), range(3), slice(1), np.datetime64("2020-01-01"), np.array(["text"])],
    ids=lambda value: type(value).__name__,
)
@pytest.mark.parametrize("protocol", [2, 5])
def test_other_harmless_objects_are_refused_too(tmp_path: Path, value: Any, protocol: int) -> None:
    (tmp_path / "a.pkl").write_bytes(history_with(value, protocol))
    with pytest.raises(RefusedPickleError, match=r"a\.pkl was refused"):
        load_pickle(tmp_path / "a.pkl")


def test_a_pickle_over_the_limit_is_read_when_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "large.pkl"
    path.write_bytes(pickle.dumps(np.zeros(300_000)))
    with pytest.raises(RefusedPickleError, match="--largest-pickle"):
        load_pickle(path, largest_mebibytes=1)
    assert load_pickle(path, largest_mebibytes=3).shape == (300_000,)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(RefusedPickleError, match=r"none\.pkl cannot be read"):
        load_pickle(tmp_path / "none.pkl")


def test_a_hostile_value_deep_inside_good_books(tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    history = {**HISTORY, "periodical_infos": [{"task_infos": [Calls(os.system, f"touch {trace}")]}]}
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(history))
    with pytest.raises(RefusedPickleError):
        load_pickle(tmp_path / "a.pkl")
    assert not trace.exists()

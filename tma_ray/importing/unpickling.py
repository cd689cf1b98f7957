"""Reads pickles that hold numpy arrays and builtin containers, and refuses all others.

A pickle is a program: loading one with `pickle.load` runs whatever its author wanted. Here the only names
that it can reach are stand-ins of ours, each of which makes one kind of array or container and checks what
it is given. No module is imported on its behalf, and no function of numpy gets unchecked arguments.
"""

from __future__ import annotations

import copyreg
import io
import math
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np

from tma_ray.decoding import DamagedFileError, check_file
from tma_ray.importing.errors import RefusedPickleError
from tma_ray.importing.opcodes import PickleRefusal, check_opcodes

LARGEST_MEBIBYTES: Final = 512
"""Size over which a pickle is refused unless somebody asks for it, MiB; that of 20 million steps has tens."""

_NUMBERS: Final = re.compile(r"([<>|=]?)(b1|[iu][1248]|f[248])")
_DAMAGE: Final = (
    *(pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError, LookupError),
    *(OverflowError, MemoryError, RecursionError, ImportError),
)


def load_pickle(path: Path, largest_mebibytes: int = LARGEST_MEBIBYTES) -> Any:
    """Returns what a pickle of any protocol holds: containers, text, numbers, numeric numpy arrays.

    Arrays of objects, of text or of records, and instances of any class, are refused.

    Args:
        path: of the file.
        largest_mebibytes: size over which it is refused, MiB.

    Raises:
        RefusedPickleError: the file does not exist, is too large or incomplete, or asks for anything
            else; nothing that it asked for was imported, called or changed.
    """
    try:
        check_file(path)
        size = path.stat().st_size
        if size > largest_mebibytes << 20:
            raise RefusedPickleError(
                f"{path} has {size / (1 << 20):,.0f} MiB, more than the {largest_mebibytes:,} MiB that are "
                f"read: if that is right, allow more with --largest-pickle"
            )
        data = path.read_bytes()
    except DamagedFileError as error:
        raise RefusedPickleError(str(error)) from error
    except OSError as error:
        raise RefusedPickleError(f"{path} cannot be read ({error.strerror}): copy it again") from error
    try:
        check_opcodes(data)
        copyreg.clear_extension_cache()
        return _Unpickler(io.BytesIO(data), encoding="latin1").load()
    except PickleRefusal as error:
        raise RefusedPickleError(f"{path} was refused: {error}; nothing of it was run") from error
    except _DAMAGE as error:
        raise RefusedPickleError(
            f"{path} was refused: {_told(error)}; nothing of it was run. Copy it again if it is damaged"
        ) from error


def _told(error: BaseException) -> str:
    return f"it is not a pickle of arrays and containers ({type(error).__name__}: {str(error)[:120]})"


class _Unpickler(pickle.Unpickler):
    """Knows the names of `_GRANTED` and no others."""

    def find_class(self, module: str, name: str) -> Any:
        granted = _GRANTED.get((module, name))
        if granted is None:
            raise PickleRefusal(
                f"it asks for {f'{module}.{name}'[:80]!r}, and may have numpy arrays and builtin containers "
                f"only"
            )
        return granted

    def persistent_load(self, pid: Any) -> NoReturn:  # noqa: ARG002 - the interface of pickle
        raise PickleRefusal("it asks for a persistent id, which no array or container needs")


class _StandIn:
    """Stand-in for a name of a pickle, which no pickle can change or make a subclass of."""

    __slots__ = ("_make",)
    _make: Callable[..., Any] | None

    def __init__(self, make: Callable[..., Any] | None = None) -> None:
        object.__setattr__(self, "_make", make)

    def __call__(self, *arguments: Any) -> Any:
        if self._make is None:
            raise PickleRefusal("it calls numpy.ndarray itself, which no array needs")
        return self._make(*arguments)

    def __setattr__(self, name: str, value: Any) -> NoReturn:
        raise PickleRefusal(f"it tries to change {name[:40]!r} of a name that it was given")

    def __setstate__(self, state: Any) -> NoReturn:
        raise PickleRefusal("it tries to change a name that it was given")


class _Type:
    """The type of an array's numbers; a real dtype may be shared with the whole process."""

    __slots__ = ("_code", "real")

    def __init__(self, order: str, code: str) -> None:
        self._code = code
        self.real: np.dtype[Any] = _real(order, code)

    def __setstate__(self, state: Any) -> None:
        plain = isinstance(state, tuple) and len(state) >= 5 and state[2:5] == (None, None, None)
        if not plain or state[1] not in ("<", ">", "|", "="):
            raise PickleRefusal("an array has records instead of numbers")
        self.real = _real(state[1], self._code)


def _real(order: str, code: str) -> np.dtype[Any]:
    return np.dtype(("" if order == "|" else order) + code)


class _Array(np.ndarray[Any, Any]):
    """An array whose content is checked before numpy takes it."""

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) not in (4, 5):
            raise PickleRefusal("the content of an array is not what numpy writes")
        shape, kind, by_columns, data = state[-4:]
        data = data.encode("latin1") if isinstance(data, str) else data
        _check_array(shape, kind, data)
        checked: Any = (1, shape, kind.real, bool(by_columns), data)
        super().__setstate__(checked)


def _check_array(shape: Any, kind: Any, data: Any) -> None:
    if not isinstance(kind, _Type) or not isinstance(data, bytes | bytearray):
        raise PickleRefusal("an array holds objects instead of numbers")
    sizes = isinstance(shape, tuple) and all(type(size) is int and size >= 0 for size in shape)
    if not sizes or len(shape) > 8 or math.prod(shape) * kind.real.itemsize != len(data):
        raise PickleRefusal("the shape of an array does not fit its content")


def _reconstruct(*arguments: Any) -> _Array:
    if (
        len(arguments) != 3
        or arguments[0] is not _NDARRAY
        or arguments[1:] not in (((0,), b"b"), ((0,), "b"))
    ):
        raise PickleRefusal("an array is begun in another way than numpy does")
    return np.ndarray.__new__(_Array, (0,), dtype=np.uint8)


def _scalar(*arguments: Any) -> bool | int | float:
    if len(arguments) != 2:
        raise PickleRefusal("a number is not what numpy writes")
    kind, data = arguments
    data = data.encode("latin1") if isinstance(data, str) else data
    _check_array((), kind, data)
    value: bool | int | float = np.frombuffer(data, dtype=kind.real)[0].item()
    return value


def _from_buffer(*arguments: Any) -> Any:
    if len(arguments) != 4 or arguments[3] not in ("C", "F"):
        raise PickleRefusal("an array is not what numpy writes")
    data, kind, shape, order = arguments
    _check_array(shape, kind, data)
    return np.frombuffer(bytes(data), dtype=kind.real).reshape(shape, order=order)


def _type(*arguments: Any) -> _Type:
    code = arguments[0] if arguments else None
    found = _NUMBERS.fullmatch(code) if isinstance(code, str) else None
    if found is None or not all(isinstance(flag, int) for flag in arguments[1:]) or len(arguments) > 3:
        raise PickleRefusal("an array holds something else than real numbers")
    return _Type(found[1] or "=", found[2])


def _latin1(*arguments: Any) -> bytes:
    if len(arguments) != 2 or type(arguments[0]) is not str or arguments[1] not in ("latin1", "latin-1"):
        raise PickleRefusal("it encodes text in another way than pickles write bytes")
    return arguments[0].encode("latin1")


def _bytes(*arguments: Any) -> bytes:
    if arguments:
        raise PickleRefusal("it makes bytes in another way than pickles do")
    return b""


def _set_of(kind: type[set[Any]] | type[frozenset[Any]]) -> Callable[..., Any]:
    def make(*arguments: Any) -> Any:
        items = arguments[0] if len(arguments) == 1 else None
        if not isinstance(items, list) or not all(
            isinstance(item, str | bytes | int | float | None) for item in items
        ):
            raise PickleRefusal("a set holds something else than text and numbers")
        return kind(items)

    return make


_NDARRAY: Final = _StandIn()
_SETS: Final = {
    (module, kind.__name__): _StandIn(_set_of(kind))
    for module in ("builtins", "__builtin__")
    for kind in (set, frozenset)
}
_ARRAYS: Final = {
    (f"numpy.{core}.{module}", name): _StandIn(make)
    for core in ("core", "_core")
    for module, name, make in (
        ("multiarray", "_reconstruct", _reconstruct),
        ("multiarray", "scalar", _scalar),
        ("numeric", "_frombuffer", _from_buffer),
    )
}
_GRANTED: Final = {
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): _StandIn(_type),
    ("_codecs", "encode"): _StandIn(_latin1),
    ("builtins", "bytes"): _StandIn(_bytes),
    ("__builtin__", "bytes"): _StandIn(_bytes),
    **_SETS,
    **_ARRAYS,
}
"""All names that a pickle may ask for, as protocols 0 to 5 of numpy 1 and 2 spell them."""

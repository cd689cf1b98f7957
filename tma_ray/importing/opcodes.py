"""Static checks of a pickle before it is loaded: nothing in here runs or builds anything of it.

`pickle.Unpickler` asks `find_class` for names, and for nothing else: cached extension codes pass it by, a
huge memo index or a declared length takes gigabytes, and a deep tuple as a key overflows the stack.
"""

from __future__ import annotations

import pickletools
from collections.abc import Callable
from functools import partial
from typing import Final

DEEPEST: Final = 100
"""How deep containers may be nested; those of the original's history are less than ten deep."""

MEMO_GAP: Final = 100_000
"""How far a memo index may be ahead of the number of memoised values; optimised pickles leave gaps."""

_FORBIDDEN: Final = {
    "PERSID": "a persistent id",
    "BINPERSID": "a persistent id",
    "EXT1": "an extension code",
    "EXT2": "an extension code",
    "EXT4": "an extension code",
    "INST": "an instance of a class",
    "OBJ": "an instance of a class",
    "NEWOBJ": "an instance of a class",
    "NEWOBJ_EX": "an instance of a class",
    "NEXT_BUFFER": "a buffer beside the file",
    "READONLY_BUFFER": "a buffer beside the file",
}
_ATOMS: Final = (
    *("NONE", "NEWTRUE", "NEWFALSE", "INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4"),
    *("FLOAT", "BINFLOAT", "STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "SHORT_BINUNICODE"),
    *("BINUNICODE", "BINUNICODE8", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8"),
)
_COUNT_BYTES: Final = {
    pickletools.TAKEN_FROM_ARGUMENT1: 1,
    pickletools.TAKEN_FROM_ARGUMENT4: 4,
    pickletools.TAKEN_FROM_ARGUMENT4U: 4,
    pickletools.TAKEN_FROM_ARGUMENT8U: 8,
}


_SIZES: Final = [0] * 256
for _opcode in pickletools.opcodes:
    _SIZES[ord(_opcode.code)] = 0 if _opcode.arg is None else _opcode.arg.n
_STOP: Final = ord(".")
_TWO_LINES: Final = b"ci"
"""Opcodes of names: module and name each have a line."""


class PickleRefusal(ValueError):  # noqa: N818 - a reason, which its catcher makes an error about a file
    """Reason why a pickle is refused."""


class _Walk:
    """Follows the pickle machine's stack, of which only nesting depths are kept: 0 for what can be a key."""

    def __init__(self) -> None:
        self.stack: list[int] = []
        self.marks: list[int] = []
        self.memo: dict[int, int] = {}

    def handlers(self) -> list[Callable[[bytes], None] | None]:
        """Returns by opcode what it does to the stack, given its argument; None if it pushes an atom."""
        named: dict[str, Callable[[bytes], None] | None] = dict.fromkeys(_ATOMS)
        for number, name in enumerate(("TUPLE1", "TUPLE2", "TUPLE3"), start=1):
            named[name] = partial(self._tuple_of, number)
        for name in ("PUT", "BINPUT", "LONG_BINPUT", "GET", "BINGET", "LONG_BINGET"):
            change = self._put if name.endswith("PUT") else self._get
            named[name] = partial(change, _number if name in ("PUT", "GET") else _little_endian)
        for name in _FORBIDDEN:
            named[name] = partial(_forbid, name)
        for opcode in pickletools.opcodes:
            if opcode.name not in named:
                named[opcode.name] = getattr(self, f"_{opcode.name.lower()}")
        found: list[Callable[[bytes], None] | None] = [_unknown] * 256
        for opcode in pickletools.opcodes:
            found[ord(opcode.code)] = named[opcode.name]
        return found

    def _put(self, read: Callable[[bytes], int], argument: bytes) -> None:
        index = read(argument)
        if not 0 <= index <= len(self.memo) + MEMO_GAP:
            raise PickleRefusal(
                f"it puts a value at place {index:,} of its memo, which has {len(self.memo):,}"
            )
        self.memo[index] = self.stack[-1]

    def _get(self, read: Callable[[bytes], int], argument: bytes) -> None:
        self.stack.append(self.memo[read(argument)])

    def _memoize(self, _: bytes) -> None:
        self.memo[len(self.memo)] = self.stack[-1]

    def _mark(self, _: bytes) -> None:
        self.marks.append(len(self.stack))

    def _tuple_of(self, count: int, _: bytes) -> None:
        self._pack(self._popped(count))

    def _popped(self, count: int) -> list[int]:
        if len(self.stack) < count:
            raise IndexError
        items = self.stack[len(self.stack) - count :]
        del self.stack[len(self.stack) - count :]
        return items

    def _marked(self) -> list[int]:
        first = self.marks.pop()
        items = self.stack[first:]
        del self.stack[first:]
        return items

    def _pack(self, items: list[int]) -> None:
        depth = 1 + max(items) if items else 1
        if depth > DEEPEST:
            raise PickleRefusal(f"its containers are nested deeper than {DEEPEST}")
        self.stack.append(depth)

    def _fill(self, items: list[int]) -> None:
        self._pack([self.stack.pop() - 1, *items])

    def _keys(self, keys: list[int]) -> None:
        if any(keys):
            raise PickleRefusal("a key of a dictionary or set is neither text nor a number")

    def _proto(self, _: bytes) -> None:
        """Leaves the stack alone."""

    _frame = _stop = _proto

    def _empty_list(self, _: bytes) -> None:
        self.stack.append(1)

    _empty_tuple = _empty_dict = _empty_set = _bytearray8 = _global = _empty_list

    def _stack_global(self, _: bytes) -> None:
        self._popped(2)
        self.stack.append(1)

    _reduce = _stack_global

    def _build(self, _: bytes) -> None:
        self._popped(1)

    def _pop(self, _: bytes) -> None:
        if self.marks and self.marks[-1] == len(self.stack):
            self.marks.pop()
        else:
            self._popped(1)

    def _pop_mark(self, _: bytes) -> None:
        self._marked()

    def _dup(self, _: bytes) -> None:
        self.stack.append(self.stack[-1])

    def _list(self, _: bytes) -> None:
        self._pack(self._marked())

    _tuple = _list

    def _dict(self, _: bytes) -> None:
        items = self._marked()
        self._keys(items[::2])
        self._pack(items)

    def _frozenset(self, _: bytes) -> None:
        items = self._marked()
        self._keys(items)
        self._pack(items)

    def _append(self, _: bytes) -> None:
        self._fill(self._popped(1))

    def _appends(self, _: bytes) -> None:
        self._fill(self._marked())

    def _setitem(self, _: bytes) -> None:
        items = self._popped(2)
        self._keys(items[::2])
        self._fill(items)

    def _setitems(self, _: bytes) -> None:
        items = self._marked()
        self._keys(items[::2])
        self._fill(items)

    def _additems(self, _: bytes) -> None:
        items = self._marked()
        self._keys(items)
        self._fill(items)


def check_opcodes(data: bytes) -> None:
    """Refuses a pickle that would build anything but containers and what `find_class` grants.

    Raises:
        PickleRefusal: it would, its parts are out of proportion, or it is incomplete.
    """
    walk, start = _Walk(), 0
    handlers, push = walk.handlers(), walk.stack.append
    try:
        while (code := data[start]) != _STOP:
            size = _SIZES[code]
            end = start + 1 + size if size >= 0 else _end(data, start + 1, code)
            handle = handlers[code]
            if handle is None:
                push(0)
            else:
                handle(data[start + 1 : end])
            start = end
    except (IndexError, KeyError) as error:
        raise PickleRefusal("it is cut off or damaged") from error
    if walk.marks or len(walk.stack) != 1:
        raise PickleRefusal("it is cut off or damaged")


def _end(data: bytes, start: int, code: int) -> int:
    """Returns the position after an argument of no fixed size, which begins at `start`."""
    size = _SIZES[code]
    if size == pickletools.UP_TO_NEWLINE:
        end = start
        for _ in range(2 if code in _TWO_LINES else 1):
            end = data.find(b"\n", end) + 1
            if not end:
                raise IndexError
        return end
    width = _COUNT_BYTES[size]
    return start + width + int.from_bytes(data[start : start + width], "little")


def _little_endian(argument: bytes) -> int:
    return int.from_bytes(argument, "little")


def _number(argument: bytes) -> int:
    try:
        return int(argument)
    except ValueError as error:
        raise PickleRefusal("a place of its memo is not a number") from error


def _forbid(name: str, _: bytes) -> None:
    raise PickleRefusal(f"it asks for {_FORBIDDEN[name]}, which no array or container needs")


def _unknown(_: bytes) -> None:
    raise PickleRefusal("it has an instruction that no pickle has")

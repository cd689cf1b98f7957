"""Colours, markers and dashes of everything that is drawn: one look for each teacher wherever it appears."""

import functools
import hashlib
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType
from typing import NamedTuple

from analysis.names import plain_name

INK = "#22262b"

MUTED = "#6a717b"

RULE = "#d9dce1"


class Look(NamedTuple):
    """Look of one teacher: colour, marker and dashes, distinct without colour too."""

    colour: str
    marker: str
    dashes: str | tuple[int, tuple[int, ...]]


# Okabe and Ito's colour-blind safe palette, its yellow darkened to be seen on white.
_LOOKS = {
    "random": Look("#4d4d4d", "o", (0, (4, 2))),
    "adr": Look("#009e73", "s", "-"),
    "alpgmm": Look("#0072b2", "D", "-"),
    "covargmm": Look("#e69f00", "^", "-"),
    "goalgan": Look("#d55e00", "v", "-"),
    "riac": Look("#56b4e9", "P", "-"),
    "settersolver": Look("#cc79a7", "X", "-"),
    "spdl": Look("#a89a00", "p", "-"),
}

# For teachers of other authors: far from the paper's eight, and from each other, in CIE L*a*b* (30 and more).
_OTHER_COLOURS = (
    "#3333dd", "#e23de2", "#000059", "#e20051", "#00a600", "#590000", "#3d5bf2", "#cc8866",
    "#3c5900", "#cc0088", "#591643", "#ca79f2", "#f20000", "#6e00a6", "#593b00", "#6e53a6",
)  # fmt: skip

_OTHER_MARKERS = ("h", "<", ">", "*", "d")

_OTHER_DASHES = ((0, (1, 1)), (0, (6, 2)), (0, (3, 1, 1, 1)))

_SHOWN_TOGETHER: ContextVar[Mapping[str, Look]] = ContextVar("shown_together", default=MappingProxyType({}))


def look(teacher: str) -> Look:
    """Return the look of `teacher`.

    Of an unknown teacher it follows from the name alone, and within `shown_together` also from the others.
    """
    known = _LOOKS.get(plain_name(teacher)) or _SHOWN_TOGETHER.get().get(teacher)
    return known or _Places.of(teacher).look()


@contextmanager
def shown_together(teachers: Iterable[str]) -> Iterator[None]:
    """Context manager that gives each of `teachers` a look of its own.

    No colour is used twice before all are used, nor a colour with the same marker. A context within another
    that has all its teachers leaves looks as they are, so that all parts of a page agree.

    Args:
        teachers: all that one figure, or one page, shows.
    """
    names = set(map(str, teachers))
    outer = _SHOWN_TOGETHER.get()
    unknown = {name for name in names if plain_name(name) not in _LOOKS}
    token = _SHOWN_TOGETHER.set(outer if unknown <= set(outer) else _assigned(unknown | set(outer)))
    try:
        yield
    finally:
        _SHOWN_TOGETHER.reset(token)


class _Places(NamedTuple):
    """Indices of a colour, a marker and dashes among those of teachers without a fixed look."""

    colour: int
    marker: int
    dashes: int

    @classmethod
    def of(cls, teacher: str) -> "_Places":
        digest = hashlib.sha256(teacher.encode()).digest()
        return cls(
            digest[0] % len(_OTHER_COLOURS), digest[1] % len(_OTHER_MARKERS), digest[2] % len(_OTHER_DASHES)
        )

    def look(self) -> Look:
        return Look(_OTHER_COLOURS[self.colour], _OTHER_MARKERS[self.marker], _OTHER_DASHES[self.dashes])


def _assigned(teachers: Iterable[str]) -> dict[str, Look]:
    """Return the look of each teacher: its own if free, else the least used one."""
    taken: list[_Places] = []
    for teacher in sorted(teachers):
        own = _Places.of(teacher)
        found = min(
            itertools.product(*map(range, map(len, (_OTHER_COLOURS, _OTHER_MARKERS, _OTHER_DASHES)))),
            key=functools.partial(_cost, own, taken),
        )
        taken.append(_Places(*found))
    return {teacher: places.look() for teacher, places in zip(sorted(teachers), taken, strict=True)}


def _cost(own: _Places, taken: Sequence[_Places], place: tuple[int, int, int]) -> tuple[int, ...]:
    """Return the uses of a colour, of a colour with its marker, and of all three; then the changes."""
    uses = (sum(other[:count] == place[:count] for other in taken) for count in (1, 2, 3))
    sizes = map(len, (_OTHER_COLOURS, _OTHER_MARKERS, _OTHER_DASHES))
    return (*uses, *((here - there) % size for here, there, size in zip(place, own, sizes, strict=True)))


RETURN_COLOURS = "viridis"
"""Perceptually uniform and readable with any colour vision."""

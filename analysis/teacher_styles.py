"""Colours of charts, and a colour, marker and dash pattern for every teacher."""

import functools
import hashlib
import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType
from typing import NamedTuple

from analysis.names import plain_name

INK = "#22262b"

MUTED = "#6a717b"

RULE = "#d9dce1"


class TeacherStyle(NamedTuple):
    """Colour, marker and dashes of a teacher, distinguishable even without colour."""

    colour: str
    marker: str
    dashes: str | tuple[int, tuple[int, ...]]


# Okabe and Ito's colour-blind safe palette, with its yellow darkened to be visible on white.
_STYLES = {
    "random": TeacherStyle("#4d4d4d", "o", (0, (4, 2))),
    "adr": TeacherStyle("#009e73", "s", "-"),
    "alpgmm": TeacherStyle("#0072b2", "D", "-"),
    "covargmm": TeacherStyle("#e69f00", "^", "-"),
    "goalgan": TeacherStyle("#d55e00", "v", "-"),
    "riac": TeacherStyle("#56b4e9", "P", "-"),
    "settersolver": TeacherStyle("#cc79a7", "X", "-"),
    "spdl": TeacherStyle("#a89a00", "p", "-"),
}

# Colours of other teachers, with a CIELAB distance of at least 30 between any two, and to those above.
_OTHER_COLOURS = (
    "#3333dd", "#e23de2", "#000059", "#e20051", "#00a600", "#590000", "#3d5bf2", "#cc8866",
    "#3c5900", "#cc0088", "#591643", "#ca79f2", "#f20000", "#6e00a6", "#593b00", "#6e53a6",
)  # fmt: skip

_OTHER_MARKERS = ("h", "<", ">", "*", "d")

_OTHER_DASHES = ((0, (1, 1)), (0, (6, 2)), (0, (3, 1, 1, 1)))

_SIZES = len(_OTHER_COLOURS), len(_OTHER_MARKERS), len(_OTHER_DASHES)

_SHOWN_TOGETHER: ContextVar[Mapping[str, TeacherStyle]] = ContextVar(
    "shown_together", default=MappingProxyType({})
)


def teacher_style(teacher: str) -> TeacherStyle:
    """Return the style of `teacher`.

    The style of a teacher that is not in the paper depends on its name and, within `shown_together`, also on
    the other teachers.
    """
    fixed = _STYLES.get(plain_name(teacher)) or _SHOWN_TOGETHER.get().get(teacher)
    return fixed or _style(_hashed(teacher))


@contextmanager
def shown_together(teachers: Iterable[str]) -> Iterator[None]:
    """Context manager that gives each of `teachers` a style of its own.

    No colour is used twice before all are used, nor a colour with the same marker. A context within another
    that has all its teachers leaves styles as they are, so that all parts of a page agree.

    Args:
        teachers: all teachers of a figure or a page.
    """
    names = set(map(str, teachers))
    outer = _SHOWN_TOGETHER.get()
    others = {name for name in names if plain_name(name) not in _STYLES}
    token = _SHOWN_TOGETHER.set(outer if others <= set(outer) else _assigned(others | set(outer)))
    try:
        yield
    finally:
        _SHOWN_TOGETHER.reset(token)


def _hashed(teacher: str) -> tuple[int, ...]:
    """Return the indices of colour, marker and dashes that a hash of the teacher's name selects."""
    digest = hashlib.sha256(teacher.encode()).digest()
    return tuple(byte % size for byte, size in zip(digest, _SIZES, strict=False))


def _style(indices: tuple[int, ...]) -> TeacherStyle:
    colour, marker, dashes = indices
    return TeacherStyle(_OTHER_COLOURS[colour], _OTHER_MARKERS[marker], _OTHER_DASHES[dashes])


def _assigned(teachers: Iterable[str]) -> dict[str, TeacherStyle]:
    """Return the style of each teacher: the one selected by its name if free, else the least used one."""
    taken: dict[str, tuple[int, ...]] = {}
    for teacher in sorted(teachers):
        cost = functools.partial(_cost, _hashed(teacher), taken.values())
        taken[teacher] = min(itertools.product(*map(range, _SIZES)), key=cost)
    return {teacher: _style(indices) for teacher, indices in taken.items()}


def _cost(
    hashed: tuple[int, ...], taken: Collection[tuple[int, ...]], indices: tuple[int, ...]
) -> tuple[int, ...]:
    """Return the sort key of a style, the lowest for the style to assign.

    It counts how often its colour, its colour and marker, and the full style are taken, and ends with its
    distance from the hashed indices.
    """
    uses = (sum(other[:count] == indices[:count] for other in taken) for count in (1, 2, 3))
    changes = ((new - old) % size for new, old, size in zip(indices, hashed, _SIZES, strict=True))
    return (*uses, *changes)


RETURN_COLOURS = "viridis"
"""Perceptually uniform and readable with any colour vision."""

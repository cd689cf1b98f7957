"""Colours, markers and dashes of everything that is drawn: one look for each teacher wherever it appears."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

from analysis.names import plain_name

INK = "#22262b"

MUTED = "#6a717b"

RULE = "#d9dce1"


class Look(NamedTuple):
    """How one teacher is drawn: colour, marker and dashes, so that colour never carries it alone."""

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

# Paul Tol's muted palette, for teachers of other authors.
_OTHER_COLOURS = ("#332288", "#882255", "#117733", "#aa4499", "#999933", "#44aa99", "#cc6677")

_OTHER_MARKERS = ("h", "<", ">", "*", "d")

_OTHER_DASHES = ((0, (1, 1)), (0, (6, 2)), (0, (3, 1, 1, 1)))


def look(teacher: str) -> Look:
    """Returns how `teacher` is drawn; for an unknown one it follows from the name alone."""
    known = _LOOKS.get(plain_name(teacher))
    if known is not None:
        return known
    digest = hashlib.sha256(teacher.encode()).digest()
    return Look(
        _OTHER_COLOURS[digest[0] % len(_OTHER_COLOURS)],
        _OTHER_MARKERS[digest[1] % len(_OTHER_MARKERS)],
        _OTHER_DASHES[digest[2] % len(_OTHER_DASHES)],
    )


RETURN_COLOURS = "viridis"
"""Perceptually uniform and readable with any colour vision."""

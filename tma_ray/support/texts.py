"""Formatting of counts, durations and sizes for users, and removal of control characters."""

import math
import re
from itertools import pairwise
from typing import Final

_COLOURS: Final = re.compile(r"\x1b\[[0-9;]*m")
CONTROL: Final = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]|\r(?!\n)"
)
"""Pattern of control characters (except tabs and line ends), bidirectional marks and lone surrogates."""


def counted(number: int, one: str, many: str | None = None) -> str:
    """Format a number with its noun, as in "1 run" or "1,200 runs"; `many` is an irregular plural."""
    return f"{number:,} {one if number == 1 else many or f'{one}s'}"


def duration(seconds: float) -> str:
    """Format a duration in its two largest units.

    Examples:
        >>> duration(42), duration(200), duration(7300), duration(200_000)
        ('42 s', '3 min 20 s', '2 h 1 min', '2 d 7 h')
    """
    units = [(86_400, "d"), (3_600, "h"), (60, "min"), (1, "s")]
    for (size, name), (smaller, smaller_name) in pairwise(units):
        if seconds >= size:
            return f"{int(seconds // size)} {name} {int(seconds % size // smaller)} {smaller_name}"
    return f"{int(seconds)} s"


def rounded_duration(seconds: float) -> str:
    """Format a duration in one unit, as in "12 s", "34 minutes" or "5.6 hours"."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} minutes" if seconds < 7200 else f"{seconds / 3600:.1f} hours"


def estimated_duration(hours: float) -> str:
    """Format a duration in one unit, with minutes rounded up, as in "5 min", "1.5 h" or "4 days"."""
    if hours >= 72:
        return f"{hours / 24:,.0f} days"
    return f"{hours:.1f} h" if hours >= 1 else f"{math.ceil(hours * 60)} min"


def hours_text(hours: float) -> str:
    """Format hours with two significant digits, or as a whole number if at least 10."""
    return f"{hours:,.0f}" if hours >= 10 else f"{hours:.2g}"


def size_text(gib: float) -> str:
    """Format a size in GiB, or in MiB if it is below 1 GiB."""
    return f"{gib:,.1f} GiB" if gib >= 1 else f"{max(1, round(gib * 1024))} MiB"


def visible(text: str) -> str:
    r"""Return `text` without colour codes, and with "�" for every other control character.

    Untrusted names and errors could otherwise clear the screen or reverse a line.

    Examples:
        >>> visible("\x1b[31mred\x1b[0m \x1b]0;title\x07 \u202eabc")
        'red �]0;title� �abc'
    """
    return CONTROL.sub("�", _COLOURS.sub("", text))

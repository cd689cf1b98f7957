"""Formatting of counts and untrusted texts for terminals."""

import re
from typing import Final

_COLOURS: Final = re.compile(r"\x1b\[[0-9;]*m")
OBEYED: Final = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]|\r(?!\n)"
)
"""Control characters except tabs and line ends, bidirectional marks, lone surrogates."""


def counted(number: int, one: str, many: str | None = None) -> str:
    """Return a number with its noun, as in "1 run" or "1,200 runs", with an irregular plural `many`."""
    return f"{number:,} {one if number == 1 else many or f'{one}s'}"


def visible(text: str) -> str:
    r"""Return `text` without colours, and with "�" for every other control character.

    Untrusted names and errors could otherwise clear the screen or reverse a line.

    Examples:
        >>> visible("\x1b[31mred\x1b[0m \x1b]0;title\x07 \u202eabc")
        'red �]0;title� �abc'
    """
    return OBEYED.sub("�", _COLOURS.sub("", text))

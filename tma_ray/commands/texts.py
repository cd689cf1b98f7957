"""Texts that users give, names and licences, and texts of others as they are shown."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any, Final

SHOWN: Final = 60
"""Characters of a refused text that a message repeats."""

_COLOURS: Final = re.compile(r"\x1b\[[0-9;]*m")
OBEYED: Final = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]|\r(?!\n)"
)
"""Control characters but tabs and line ends, marks of the direction of writing, and halves of characters."""

_IDENTIFIER: Final = r"\d*[A-Za-z][\w.-]*\+?"
_LICENCE: Final = re.compile(rf"{_IDENTIFIER}( (AND|OR|WITH) {_IDENTIFIER})*", re.ASCII)
_LONGEST_LICENCE: Final = 200


def refused(text: str, reason: str) -> ValueError:
    """Returns the error of a text that is refused for a `reason`, which follows the text."""
    shown = text if len(text) <= SHOWN else f"{text[:SHOWN]}…"
    return ValueError(f"{shown!r}: {reason}")


def counted(number: int, one: str, many: str | None = None) -> str:
    """Returns a number with its noun: "1 run", "1,200 runs".

    Args:
        number: how many.
        one: the noun of one.
        many: of several, if that is not `one` with an s.
    """
    return f"{number:,} {one if number == 1 else many or f'{one}s'}"


def visible(text: str) -> str:
    r"""Returns `text` without colours, and with "�" for every other character that a terminal would obey.

    Names and errors may come from results of others: printed as they are, they could clear the screen, set
    the title of the window, or show a line from right to left.

    Examples:
        >>> visible("\x1b[31mred\x1b[0m \x1b]0;title\x07 \u202eabc")
        'red �]0;title� �abc'
    """
    return OBEYED.sub("�", _COLOURS.sub("", text))


class VisibleStream:
    """A stream of text that writes what `visible` leaves of it.

    Args:
        stream: output or error stream; rich writes to it directly, so that its own colours stay
            (`tma_ray.terminal`).
    """

    def __init__(self, stream: Any) -> None:
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        """Writes a text; returns its length."""
        self.rich_proxied_file.write(visible(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Writes texts one after the other."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


def check_visible(text: str, expected: str) -> None:
    """Refuses an empty text, and control characters.

    Raises:
        ValueError: the message says what was `expected`.
    """
    if not text.strip() or min(text) < " ":
        raise refused(text, f"expected {expected}")


def named(expected: str) -> Callable[[str], str]:
    """Returns a parser of texts that are not empty.

    Args:
        expected: what a refusal says was expected, as "the name of a run".
    """

    def parse(text: str) -> str:
        check_visible(text, expected)
        return text

    return parse


def licence(text: str) -> str:
    """Returns the licence that `text` names, an SPDX expression without parentheses.

    Raises:
        ValueError: it names none.

    Examples:
        >>> licence("CC-BY-4.0"), licence("MIT OR Apache-2.0")
        ('CC-BY-4.0', 'MIT OR Apache-2.0')
    """
    if not _LICENCE.fullmatch(text) or len(text) > _LONGEST_LICENCE:
        raise refused(text, "expected a licence as SPDX names it, such as CC-BY-4.0 or MIT")
    return text

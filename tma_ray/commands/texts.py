"""Texts that users give: names, licences."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from typing import Final

SHOWN: Final = 60
"""Characters of a refused text that a message repeats."""

_IDENTIFIER: Final = r"\d*[A-Za-z][\w.-]*\+?"
_LICENCE: Final = re.compile(rf"{_IDENTIFIER}( (AND|OR|WITH) {_IDENTIFIER})*", re.ASCII)
_LONGEST_LICENCE: Final = 200


def refused(text: str, reason: str) -> argparse.ArgumentTypeError:
    """Returns the error of a text that is refused for a `reason`, which follows the text."""
    shown = text if len(text) <= SHOWN else f"{text[:SHOWN]}…"
    return argparse.ArgumentTypeError(f"{shown!r}: {reason}")


def counted(number: int, one: str, many: str | None = None) -> str:
    """Returns a number with its noun: "1 run", "1,200 runs".

    Args:
        number: how many.
        one: the noun of one.
        many: of several, if that is not `one` with an s.
    """
    return f"{number:,} {one if number == 1 else many or f'{one}s'}"


def check_visible(text: str, expected: str) -> None:
    """Refuses an empty text, and control characters.

    Raises:
        argparse.ArgumentTypeError: the message says what was `expected`.
    """
    if not text.strip() or min(text) < " ":
        raise refused(text, f"expected {expected}")


def named(expected: str) -> Callable[[str], str]:
    """Returns a parser of texts that are not empty, as argparse's ``type=`` wants it.

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
        argparse.ArgumentTypeError: it names none.

    Examples:
        >>> licence("CC-BY-4.0"), licence("MIT OR Apache-2.0")
        ('CC-BY-4.0', 'MIT OR Apache-2.0')
    """
    if not _LICENCE.fullmatch(text) or len(text) > _LONGEST_LICENCE:
        raise refused(text, "expected a licence as SPDX names it, such as CC-BY-4.0 or MIT")
    return text

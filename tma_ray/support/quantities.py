"""Parsing and checking of numbers within ranges, and expansion of home folders."""

import re
from dataclasses import dataclass
from decimal import Decimal
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Final

MOST_SHOWN_CHARS: Final = 60  # largest number of characters of a rejected string that a message shows

_NUMBER: Final = re.compile(r"(-?\d+(?:_\d+)*(?:\.\d+)?(?:[eE][+-]?\d{1,3})?)([A-Za-z]*)", re.ASCII)
_FACTORS: Final = {"": 1, "k": 1_000, "K": 1_000, "M": 1_000_000}
"""Factors of units; "m" is left out, since it could mean a thousandth or a million."""


@dataclass(frozen=True)
class Quantity:
    """Kind of number with a range; calling an instance parses a string.

    Numbers are written as 500000, 500_000, 5e5, 500k, 500K or 20M. Plus signs, infinities and NaN are
    refused.

    Attributes:
        expected: description in error messages.
        least: smallest value.
        most: largest value, generous enough to reject mistakes only.
        whole: True for whole numbers only.
        positive: True to exclude `least` itself.
    """

    expected: str
    least: float
    most: float
    whole: bool = False
    positive: bool = False

    def __call__(self, text: str) -> Any:
        """Return the number in `text`.

        Raises:
            ValueError: if it is not a number of this kind.
        """
        match = _NUMBER.fullmatch(text.strip())
        if match is not None:
            digits, unit = match.groups()
            if unit not in _FACTORS:
                raise refused(
                    text, f"unknown unit {unit!r}: k is a thousand, M a million; expected {self.expected}"
                )
            value = Decimal(digits) * _FACTORS[unit]
            if self._holds(value) and (not self.whole or value == int(value)):
                number: int | float = int(value) if self.whole else float(value)
                if self._holds(number):  # tiny decimals may have underflowed to zero
                    return number
        raise refused(text, f"expected {self.expected}")

    def check(self, name: str, value: object) -> None:
        """Raise a ValueError if the argument `name` is not a number of this kind."""
        kind = Integral if self.whole else Real
        if isinstance(value, bool) or not isinstance(value, kind) or not self._holds(value):
            raise ValueError(f"{name} = {value!s:.60}: expected {self.expected}")

    def _holds(self, value: Any) -> bool:
        return bool(self.least <= value <= self.most and not (self.positive and value == self.least))


COUNT: Final = Quantity("a whole number such as 500000, 500k or 20M, from 1 to 1e12", 1, 1e12, whole=True)
STEP: Final = Quantity("a whole number of steps from 0 to 1e12", 0, 1e12, whole=True)
SEED: Final = Quantity("a whole number from 0 to 2^63 - 1", 0, 2**63 - 1, whole=True)
PROCESSES: Final = Quantity("a whole number from 1 to 65,536", 1, 65_536, whole=True)
WIDTH: Final = Quantity("a whole number of slots from 0 to 4,096", 0, 4096, whole=True)
LOSSES: Final = Quantity("a whole number from 0 to 1e6", 0, 1e6, whole=True)
CORES: Final = Quantity("a number of cores over 0, up to 65,536, such as 1 or 0.5", 0, 65_536, positive=True)
GPUS: Final = Quantity("a share of one GPU, as in 0.25, or a whole number up to 65,536", 0, 65_536)
MEMORY: Final = Quantity("a number of GiB from 0 to 1e6", 0, 1e6)
SECONDS: Final = Quantity("a number of seconds from 0 to 1e9", 0, 1e9)
COORDINATE: Final = Quantity("a number from -1e9 to 1e9", -1e9, 1e9)
BODY_SIZE: Final = Quantity("a number over 0, up to 100", 0, 100, positive=True)
TORQUE: Final = Quantity("a number of N m over 0, up to 1e6", 0, 1e6, positive=True)
SHARE: Final = Quantity("a share over 0, up to 1", 0, 1, positive=True)


def expanded(path: str | Path) -> Path:
    """Return a path with ``~`` or ``~user`` expanded, or raise a ValueError for an unknown user."""
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise ValueError(
            f"{str(path)!r}: no home folder is known for {Path(path).parts[0]!r}; a folder of that name "
            f"is './{path}'"
        ) from error


def refused(text: str, reason: str) -> ValueError:
    """Return a ValueError for a rejected string, with the reason."""
    shown = text if len(text) <= MOST_SHOWN_CHARS else f"{text[:MOST_SHOWN_CHARS]}…"
    return ValueError(f"{shown!r}: {reason}")

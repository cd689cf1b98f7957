"""Kinds of numbers with their ranges, and paths of the home folder."""

import re
from dataclasses import dataclass
from decimal import Decimal
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Final

SHOWN: Final = 60  # number of characters of a refused text in a message

_NUMBER: Final = re.compile(r"(-?\d+(?:_\d+)*(?:\.\d+)?(?:[eE][+-]?\d{1,3})?)([A-Za-z]*)", re.ASCII)
_FACTORS: Final = {"": 1, "k": 1_000, "K": 1_000, "M": 1_000_000}
"""Values of the letters after a number; "m" is none, since it could be a thousandth or a million."""


@dataclass(frozen=True)
class Quantity:
    """Kind of number, with its range; calling it parses a text.

    Numbers are written as 500000, 500_000, 5e5, 500k, 500K or 20M, without a plus. Infinities and NaN are
    refused.

    Attributes:
        expected: description of the kind, for refusals.
        least: smallest value.
        most: largest value, beyond everything that makes sense, so that a slip is refused at once.
        whole: True if only whole numbers are accepted.
        positive: True if `least` itself is refused.
    """

    expected: str
    least: float
    most: float
    whole: bool = False
    positive: bool = False

    def __call__(self, text: str) -> Any:
        """Return the number in `text`.

        Raises:
            ValueError: a text that is not a number of this kind.
        """
        found = _NUMBER.fullmatch(text.strip())
        if found is not None:
            digits, unit = found.groups()
            if unit not in _FACTORS:
                raise refused(
                    text, f"unknown unit {unit!r}: k is a thousand, M a million; expected {self.expected}"
                )
            value = Decimal(digits) * _FACTORS[unit]
            if self._holds(value) and (not self.whole or value == int(value)):
                number: int | float = int(value) if self.whole else float(value)
                if self._holds(number):  # the smallest decimals round to zero
                    return number
        raise refused(text, f"expected {self.expected}")

    def check(self, name: str, value: object) -> None:
        """Refuse a value that is not of this kind.

        Raises:
            ValueError: the message holds `name`, the value and what was expected.
        """
        kind = Integral if self.whole else Real
        if isinstance(value, bool) or not isinstance(value, kind) or not self._holds(value):
            raise ValueError(f"{name} = {value!s:.60}: expected {self.expected}")

    def _holds(self, value: Any) -> bool:
        return bool(self.least <= value <= self.most and not (self.positive and value == self.least))


COUNT: Final = Quantity("a whole number such as 500000, 500k or 20M, from 1 to 1e12", 1, 1e12, whole=True)
"""Number of steps, episodes or tasks."""

STEP: Final = Quantity("a whole number of steps from 0 to 1e12", 0, 1e12, whole=True)  # step of a run

SEED: Final = Quantity("a whole number from 0 to 2^63 - 1", 0, 2**63 - 1, whole=True)
"""Seed of random numbers."""

PROCESSES: Final = Quantity("a whole number from 1 to 65,536", 1, 65_536, whole=True)
"""Number of processes or threads."""

WIDTH: Final = Quantity("a whole number of slots from 0 to 4,096", 0, 4096, whole=True)
"""Number of slots of a cohort."""

LOSSES: Final = Quantity("a whole number from 0 to 1e6", 0, 1e6, whole=True)
"""Number of times that something may be lost."""

CORES: Final = Quantity("a number of cores over 0, up to 65,536, such as 1 or 0.5", 0, 65_536, positive=True)
"""Cores of one run."""

GPUS: Final = Quantity("a share of one GPU, as in 0.25, or a whole number up to 65,536", 0, 65_536)
"""GPUs of one run."""

MEMORY: Final = Quantity("a number of GiB from 0 to 1e6", 0, 1e6)  # memory, GiB
SECONDS: Final = Quantity("a number of seconds from 0 to 1e9", 0, 1e9)  # time, s
COORDINATE: Final = Quantity("a number from -1e9 to 1e9", -1e9, 1e9)  # value of a dimension of a task space

BODY_SIZE: Final = Quantity("a number over 0, up to 100", 0, 100, positive=True)
"""Size of a body, as a multiple of its own."""

TORQUE: Final = Quantity("a number of N m over 0, up to 1e6", 0, 1e6, positive=True)  # torque of a motor, N m
SHARE: Final = Quantity("a share over 0, up to 1", 0, 1, positive=True)  # share of a whole


def expanded(path: str | Path) -> Path:
    """Return a path with the home folder in place of ``~`` or ``~user``.

    Raises:
        ValueError: an unknown user.
    """
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise ValueError(
            f"{str(path)!r}: no home folder is known for {Path(path).parts[0]!r}; a folder of that name "
            f"is './{path}'"
        ) from error


def refused(text: str, reason: str) -> ValueError:
    """Return the error of a refused text: the text and the `reason`."""
    shown = text if len(text) <= SHOWN else f"{text[:SHOWN]}…"
    return ValueError(f"{shown!r}: {reason}")

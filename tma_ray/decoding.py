"""JSON decoded against declared types: strict, bounded, with errors that name file and field."""

from __future__ import annotations

from collections.abc import Hashable
from functools import cache
from typing import Annotated, Any, Final, TypeAlias, TypeVar, cast

import msgspec

T = TypeVar("T")

INT32_MAX: Final = 2**31 - 1
INT64_MAX: Final = 2**63 - 1

Natural: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=INT64_MAX)]
"""A whole number from 0 on that fits a column of 64 bits."""

SmallNatural: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=INT32_MAX)]
"""A whole number from 0 on that fits a column of 32 bits."""

Sha256: TypeAlias = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
"""A checksum, hexadecimal."""


Seconds: TypeAlias = Annotated[float, msgspec.Meta(ge=0, le=4e9)]
"""A time, s since 1970, up to the year 2096."""


class DamagedFileError(ValueError):
    """A file whose content is not what was written; the message names it."""


class DamagedFileWarning(UserWarning):
    """A file could not be read and was left out; the rest was read."""


def decode_json(data: bytes | str, kind: type[T], where: str) -> T:
    """Returns the JSON in `data` as a `kind`; fields that it does not declare are ignored.

    Args:
        data: UTF-8 text.
        kind: a dataclass, or any other type that msgspec knows; numbers are never made of text.
        where: name of the file, for the message.

    Raises:
        DamagedFileError: no JSON, or a field that is missing, of another type or out of bounds; the message
            names the file and the field.
    """
    try:
        return cast("T", _decoder(cast("Hashable", kind)).decode(data))
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise DamagedFileError(f"{where} is damaged: {error}") from error


@cache
def _decoder(kind: Hashable) -> msgspec.json.Decoder[Any]:
    return msgspec.json.Decoder(kind)

"""Files that others may have made: looked at before they are read, JSON decoded against declared types."""

import os
import stat
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

Sha256: TypeAlias = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]  # a checksum, hexadecimal


Seconds: TypeAlias = Annotated[float, msgspec.Meta(ge=0, le=4e9)]  # a time, s since 1970, up to the year 2096


MOST_BYTES: Final = min(2**34, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2)
"""Size up to which a file is read whole: half of this machine's memory, but not more than 16 GiB."""

MOST_TEXT_BYTES: Final = 2**26
"""Size up to which JSON, TOML and CSV are read: decoded, they take up to twenty times as much."""

_KINDS: Final = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class DamagedFileError(ValueError):
    """A file whose content is not what was written; the message names it."""


class DamagedFileWarning(UserWarning):
    """A file could not be read and was left out; the rest was read."""


def check_file(path: str | os.PathLike[str], most_bytes: int = MOST_BYTES) -> None:
    """Refuse what cannot be read whole before it is opened: pipes wait, devices and sparse files do not end.

    Raises:
        FileNotFoundError: there is nothing at `path`.
        OSError: it cannot be looked at.
        DamagedFileError: it is not a file, or has more than `most_bytes`.
    """
    found = os.stat(path)  # noqa: PTH116 - for thousands of files
    kind = _KINDS.get(stat.S_IFMT(found.st_mode))
    if kind:
        raise DamagedFileError(f"{path} is damaged: {kind} lies in its place")
    check_size(path, found.st_size, most_bytes)


def check_size(where: str | os.PathLike[str], size: int, most_bytes: int = MOST_BYTES) -> None:
    """Refuse a file of more than `most_bytes` by a DamagedFileError."""
    if size > most_bytes:
        raise DamagedFileError(
            f"{where} is damaged: it has {size:,} bytes, more than the {most_bytes:,} that are read"
        )


def read_file(path: str | os.PathLike[str], most_bytes: int = MOST_BYTES) -> bytes:
    """Return the content of a file; raises as `check_file` does."""
    check_file(path, most_bytes)
    with open(path, "rb", buffering=0) as file:  # noqa: PTH123 - half the time, for thousands of files
        return file.read()


def decode_json(data: bytes | str, kind: type[T], where: str) -> T:
    """Return the JSON in `data` as a `kind` that msgspec knows; fields that it does not declare are ignored.

    Raises:
        DamagedFileError: no JSON, or a field that is missing, of another type or out of bounds; the message
            names the file, by `where`, and the field.
    """
    try:
        return cast("T", _decoder(cast("Hashable", kind)).decode(data))
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise DamagedFileError(f"{where} is damaged: {error}") from error


@cache
def _decoder(kind: Hashable) -> msgspec.json.Decoder[Any]:
    return msgspec.json.Decoder(kind)

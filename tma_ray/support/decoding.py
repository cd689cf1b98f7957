"""Safe reading of untrusted files: size and type checks, and JSON decoding against declared types."""

from __future__ import annotations

import os
import stat
import zipfile
from collections.abc import Hashable
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeAlias, TypeVar, cast

import msgspec

if TYPE_CHECKING:
    from numpy.typing import NDArray

ContentT = TypeVar("ContentT")

INT32_MAX: Final = 2**31 - 1
INT64_MAX: Final = 2**63 - 1

Natural: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=INT64_MAX)]  # integer from 0 to 2^63 - 1

SmallNatural: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=INT32_MAX)]
"""Integer from 0 to 2^31 - 1."""

Sha256: TypeAlias = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]  # hexadecimal checksum
Seconds: TypeAlias = Annotated[float, msgspec.Meta(ge=0, le=4e9)]  # Unix time up to the year 2096

MOST_FILE_BYTES: Final = min(2**34, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2)
"""Size limit of files read whole: half of this machine's memory, at most 16 GiB."""

MOST_TEXT_BYTES: Final = 2**26
"""Size limit of JSON, TOML and CSV files, which take up to twenty times their size in memory."""

MOST_ARRAY_BYTES: Final = 2**28  # default limit on the uncompressed content of a ``.npz`` file, bytes

_KINDS: Final = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class DamagedFileError(ValueError):
    """Error for a file with damaged or unexpected content; the message names the file."""


class DamagedFileWarning(UserWarning):
    """Warning about an unreadable file that has been left out."""


def check_file(path: str | os.PathLike[str], most_bytes: int = MOST_FILE_BYTES) -> None:
    """Check that `path` is a regular file of limited size, without opening it.

    Opening a pipe would block, and reading a device might never end.

    Raises:
        OSError: if the file is missing or not accessible.
        DamagedFileError: if it is not a file, or has more than `most_bytes`.
    """
    status = os.stat(path)  # noqa: PTH116 - for thousands of files
    kind = _KINDS.get(stat.S_IFMT(status.st_mode))
    if kind:
        raise DamagedFileError(f"{path} is damaged: {kind} lies in its place")
    check_size(path, status.st_size, most_bytes)


def check_size(where: str | os.PathLike[str], size: int, most_bytes: int = MOST_FILE_BYTES) -> None:
    """Raise a DamagedFileError for a file larger than `most_bytes`."""
    if size > most_bytes:
        raise DamagedFileError(
            f"{where} is damaged: it has {size:,} bytes, more than the {most_bytes:,} that are read"
        )


def read_file(path: str | os.PathLike[str], most_bytes: int = MOST_FILE_BYTES) -> bytes:
    """Return the content of a file that passes `check_file`."""
    check_file(path, most_bytes)
    with open(path, "rb", buffering=0) as file:  # noqa: PTH123 - half the time, for thousands of files
        return file.read()


def decode_json(data: bytes | str, kind: type[ContentT], where: str) -> ContentT:
    """Decode JSON as `kind`, a type that msgspec supports, ignoring undeclared fields.

    Raises:
        DamagedFileError: if it is not JSON, or a field is missing, of another type or out of bounds. The
            message names the file, `where`, and the field.
    """
    try:
        return cast("ContentT", _decoder(cast("Hashable", kind)).decode(data))
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise DamagedFileError(f"{where} is damaged: {error}") from error


@cache
def _decoder(kind: Hashable) -> msgspec.json.Decoder[Any]:
    return msgspec.json.Decoder(kind)


def load_npz(path: str | os.PathLike[str], most_bytes: int = MOST_ARRAY_BYTES) -> dict[str, NDArray[Any]]:
    """Return the arrays of a ``.npz`` file by name.

    Raises:
        OSError: if the file is missing.
        zipfile.BadZipFile: if it is not an archive.
        ValueError: if it would take more than `most_bytes`, or an array is damaged or contains objects.
    """
    import numpy as np  # imported late, since most commands read no arrays

    check_file(path)
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > most_bytes:
        raise ValueError(f"{path} would take {size:,} bytes, more than {most_bytes:,}")
    arrays = {}
    with np.load(path, allow_pickle=False) as content:
        for name in content:
            try:
                arrays[name] = content[name]
            except (ValueError, EOFError, MemoryError) as error:
                raise ValueError(f"array {name!r} of {path} is damaged: {error}") from error
    return arrays

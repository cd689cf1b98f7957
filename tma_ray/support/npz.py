"""Arrays in files of numpy's that others made: their sizes are checked by headers before anything is read."""

import math
import zipfile
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from tma_ray.support.decoding import check_file

MOST_BYTES: Final = 2**28  # largest content of a ``.npz`` file that is read by default, bytes

_HEADERS: Final = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def load_npz(path: Path, most_bytes: int = MOST_BYTES) -> dict[str, NDArray[Any]]:
    """Return the arrays of a ``.npz`` file by name.

    Raises:
        FileNotFoundError: the file is missing.
        zipfile.BadZipFile: it is not an archive.
        ValueError: it would take more than `most_bytes`, an array claims to be larger than it is, or holds
            objects.
    """
    check_file(path)
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
        if size > most_bytes:
            raise ValueError(f"{path} would take {size:,} bytes, more than {most_bytes:,}")
        for member in archive.infolist():
            with archive.open(member) as file:
                _check_header(file, member.file_size, f"{member.filename} of {path}")
    with np.load(path, allow_pickle=False) as content:
        return {name: content[name] for name in content}


def _check_header(file: IO[bytes], size: int, where: str) -> None:
    """Refuse an array that claims more bytes than the `size` of its file leaves."""
    try:
        shape, _, dtype = _HEADERS[np.lib.format.read_magic(file)](file)
    except (KeyError, ValueError, EOFError) as error:
        raise ValueError(f"{where} is not an array of numpy's: {error}") from error
    claimed = math.prod(shape) * dtype.itemsize
    if claimed > size - file.tell() or not dtype.itemsize:
        raise ValueError(f"{where} claims {claimed:,} bytes of numbers, and has {size - file.tell():,}")

"""Safe reading of untrusted ``.npz`` files."""

import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tma_ray.support.decoding import check_file

MOST_ARRAY_BYTES: Final = 2**28  # default limit on the unpacked content of a file, bytes


def load_npz(path: Path, most_bytes: int = MOST_ARRAY_BYTES) -> dict[str, NDArray[Any]]:
    """Return the arrays of a ``.npz`` file by name.

    Raises:
        FileNotFoundError: if the file is missing.
        zipfile.BadZipFile: if it is not an archive.
        ValueError: if it would take more than `most_bytes`, or an array is damaged or of objects.
    """
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

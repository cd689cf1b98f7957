"""Places that users name on a command line: refused at once where they cannot be what is meant."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

from tma_ray.commands.texts import check_visible, refused

SCHEMES: Final = ("s3", "gs", "gcs", "abfs", "abfss", "hdfs", "viewfs", "file", "https", "http", "hf")
"""Beginnings of addresses that results may lie at."""


def root(text: str) -> str:
    """Returns the results root that `text` names: a folder, there or to be made, or an address.

    Raises:
        ValueError: it cannot be one.
    """
    check_visible(text, "a folder, s3://bucket/folder or gs://bucket/folder")
    if "://" not in text:
        folder(text)
        return text
    address = urlsplit(text)
    if address.scheme not in SCHEMES:
        raise refused(text, f"expected a folder, or an address that begins with {SCHEMES[0]}:// or gs://")
    if address.scheme == "file":
        folder(unquote(address.path))
    if address.scheme in SCHEMES[:2] and not address.netloc:
        raise refused(text, f"it needs a bucket: {address.scheme}://bucket/folder")
    return text


def folder(text: str) -> Path:
    """Returns the folder that `text` names, there or to be made.

    Raises:
        ValueError: it cannot be one.
    """
    if "://" in text:
        raise refused(text, "expected a folder of this machine")
    mode = _mode(text, "a folder")
    if mode is not None and not stat.S_ISDIR(mode):
        raise refused(text, "it is a file; expected a folder")
    return expanded(text)


def new_file(text: str) -> Path:
    """Returns the file to write that `text` names.

    Raises:
        ValueError: it cannot be one.
    """
    mode = _mode(text, "a file")
    if mode is not None and stat.S_ISDIR(mode):
        raise refused(text, "it is a folder; expected a file")
    return expanded(text)


def expanded(path: str | Path) -> Path:
    """Returns a path with the home folder in place of ``~`` or ``~user``.

    Raises:
        ValueError: nobody is called so.
    """
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise ValueError(
            f"{str(path)!r}: no home folder is known for {Path(path).parts[0]!r}; a folder that is called so "
            f"is './{path}'"
        ) from error


def _mode(text: str, expected: str) -> int | None:
    """Returns the mode of what lies at `text`, None if nothing does; refuses what nothing can lie at."""
    check_visible(text, expected)
    try:
        path = expanded(text)
    except ValueError as error:
        raise ValueError(str(error)) from error
    try:
        for place in (path, *path.absolute().parents):
            if place.is_symlink() or place.exists():
                mode = os.stat(place).st_mode  # noqa: PTH116 - a link that leads nowhere raises
                if place is not path and not stat.S_ISDIR(mode):
                    raise refused(text, f"{place} is a file; expected a folder")
                return mode if place is path else None
    except OSError as error:
        raise refused(text, f"{error.strerror}".lower()) from error
    return None

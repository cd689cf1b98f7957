"""Parsers of command-line values: folders, addresses, names and licences."""

import os
import re
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

from tma_ray.support.quantities import expanded, refused

SCHEMES: Final = ("s3", "gs", "gcs", "abfs", "abfss", "hdfs", "viewfs", "file", "https", "http", "hf")
"""Schemes of the addresses of results."""


def root(text: str) -> str:
    """Check and return the folder or address of a results root, which need not exist."""
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
    """Parse the path of a folder, which need not exist."""
    if "://" in text:
        raise refused(text, "expected a folder of this machine")
    mode = _mode(text, "a folder")
    if mode is not None and not stat.S_ISDIR(mode):
        raise refused(text, "it is a file; expected a folder")
    return expanded(text)


def new_file(text: str) -> Path:
    """Parse the path of a file to write."""
    mode = _mode(text, "a file")
    if mode is not None and stat.S_ISDIR(mode):
        raise refused(text, "it is a folder; expected a file")
    return expanded(text)


def _mode(text: str, expected: str) -> int | None:
    """Return the mode of an existing file or folder, or None if one could be created at `text`."""
    check_visible(text, expected)
    path = expanded(text)
    try:
        for ancestor in (path, *path.absolute().parents):
            if ancestor.is_symlink() or ancestor.exists():
                mode = os.stat(ancestor).st_mode  # noqa: PTH116 - a broken link raises
                if ancestor is not path and not stat.S_ISDIR(mode):
                    raise refused(text, f"{ancestor} is a file; expected a folder")
                return mode if ancestor is path else None
    except OSError as error:
        raise refused(text, f"{error.strerror}".lower()) from error
    return None


_IDENTIFIER: Final = r"\d*[A-Za-z][\w.-]*\+?"
_LICENCE: Final = re.compile(rf"{_IDENTIFIER}( (AND|OR|WITH) {_IDENTIFIER})*", re.ASCII)
_LONGEST_LICENCE: Final = 200


def check_visible(text: str, expected: str) -> None:
    """Refuse empty strings and control characters; `expected` describes valid strings for the message."""
    if not text.strip() or min(text) < " ":
        raise refused(text, f"expected {expected}")


def named(expected: str) -> Callable[[str], str]:
    """Return a parser for non-empty strings; see `check_visible`."""

    def parse(text: str) -> str:
        check_visible(text, expected)
        return text

    return parse


def licence(text: str) -> str:
    """Parse a licence: an SPDX expression without parentheses.

    Examples:
        >>> licence("CC-BY-4.0"), licence("MIT OR Apache-2.0")
        ('CC-BY-4.0', 'MIT OR Apache-2.0')
    """
    if not _LICENCE.fullmatch(text) or len(text) > _LONGEST_LICENCE:
        raise refused(text, "expected a licence as SPDX names it, such as CC-BY-4.0 or MIT")
    return text

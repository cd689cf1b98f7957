"""Versions of installed packages."""

from __future__ import annotations

import sys
from importlib.metadata import PackageNotFoundError, version

from tma_ray.commands.exits import RefusedError


def installed_version(package: str) -> str:
    """Returns the version of an installed package.

    Raises:
        RefusedError: it is not installed, as when its folder was only copied.
    """
    try:
        return version(package)
    except PackageNotFoundError as error:
        raise RefusedError(
            f"the package {package!r} is not installed for {sys.executable}: a copied folder is not enough; "
            f"use 'pip install {package}', or 'pip install .' in a checkout"
        ) from error

"""Shipping of plug-ins to the workers: the user's own files, and nothing else of the user's."""

from __future__ import annotations

import importlib
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tma_ray.plugin_source import PluginSource

FOLDER = "tma_ray_plugins"
"""What the shipped files lie in; a worker finds it as a package of that name."""

MOST_BYTES = 20 * 2**20
"""More than this is refused: code is small, and data of that size belongs on the nodes or in storage."""


@contextmanager
def runtime_environment(sources: Sequence[PluginSource]) -> Iterator[dict[str, Any] | None]:
    """Lends the block a Ray runtime environment that brings plug-ins to every worker of a job.

    The files are copied first: what is edited while a campaign runs does not reach its workers.
    Installed packages are not shipped; every node needs them by itself.

    Args:
        sources: of the plug-ins.

    Returns:
        What `ray.init` takes, None if there is nothing to ship.

    Raises:
        ValueError: the files are larger than `MOST_BYTES`.
    """
    files = {path: code for each in sources if not each.installed for path, code in each.files.items()}
    _check_size(files)
    if not files:
        yield None
        return
    with tempfile.TemporaryDirectory() as place:
        for path, code in files.items():
            file = Path(place, FOLDER, path)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(code)
        yield {"py_modules": [str(Path(place, FOLDER))]}


def use_shipped() -> None:
    """Lets imports in this worker find the shipped files first, before what the driver left elsewhere."""
    try:
        shipped = importlib.import_module(FOLDER)
    except ModuleNotFoundError:  # nothing was shipped: all is installed, or Ray was connected before
        return
    root = next(iter(shipped.__path__))
    if root not in sys.path:
        sys.path.insert(0, root)


def _check_size(files: dict[str, bytes]) -> None:
    total = sum(map(len, files.values()))
    if total > MOST_BYTES:
        largest = max(files, key=lambda path: len(files[path]))
        raise ValueError(
            f"the plug-ins' files are {total / 2**20:.0f} MiB ({largest}: {len(files[largest]) / 2**20:.0f} "
            f"MiB), more than the {MOST_BYTES / 2**20:.0f} MiB that are shipped to workers; install them on "
            f"the nodes, or read large data from a path that all nodes have"
        )

"""Shipping of plug-ins to the workers of a Ray cluster."""

import importlib
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tma_ray.components.plugin_source import PluginSource

PACKAGE = "tma_ray_plugins"  # folder of the shipped files, which workers import as a package

MAX_SHIPPED_BYTES = 20 * 2**20
"""Largest size of shipped files, in bytes: larger data belongs on the nodes or in storage."""


@contextmanager
def runtime_environment(sources: Sequence[PluginSource]) -> Iterator[dict[str, Any] | None]:
    """Context manager that yields a Ray runtime environment which ships plug-ins to every worker of a job.

    It ships copies: edits during a campaign do not reach the workers. Installed packages are not shipped;
    every node needs them.

    Returns:
        The ``runtime_env`` of `ray.init`, None if there is nothing to ship.

    Raises:
        ValueError: if the files are larger than `MAX_SHIPPED_BYTES`.
    """
    files = {path: code for source in sources if not source.installed for path, code in source.files.items()}
    total = sum(map(len, files.values()))
    if total > MAX_SHIPPED_BYTES:
        largest = max(files, key=lambda path: len(files[path]))
        raise ValueError(
            f"the plug-ins' files are {total / 2**20:.0f} MiB ({largest}: {len(files[largest]) / 2**20:.0f} "
            f"MiB), more than the {MAX_SHIPPED_BYTES / 2**20:.0f} MiB that are shipped to workers; install "
            f"them on the nodes, or read large data from a path that all nodes have"
        )
    if not files:
        yield None
        return
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder, PACKAGE)
        for path, code in files.items():
            (package / path).parent.mkdir(parents=True, exist_ok=True)
            (package / path).write_bytes(code)
        yield {"py_modules": [str(package)]}


def use_shipped() -> None:
    """Put the shipped plug-ins first on the search path of this worker."""
    try:
        shipped = importlib.import_module(PACKAGE)
    except ModuleNotFoundError:  # nothing was shipped
        return
    root = next(iter(shipped.__path__))
    if root not in sys.path:
        sys.path.insert(0, root)

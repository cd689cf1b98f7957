"""tma_ray: fair, distributed comparison of automatic curriculum learning teachers.

Importing the package registers the environments with `gymnasium.make`.
"""

from importlib import import_module
from sys import orig_argv
from typing import Any

from tma_ray.support.interrupts import expect_early, is_command

LIBRARY = ("RunsFailedError", "TrainedRun", "run_campaign", "train")
"""Names of `tma_ray.api` that the package exports."""

__version__ = "0.1.0"

if is_command(orig_argv):  # commands register environments only when needed, to start quickly
    expect_early()
else:
    import_module("tma_ray.envs.registration")


def __getattr__(name: str) -> Any:
    """Import a name in `LIBRARY` on first use, since `tma_ray.api` loads all dependencies of a run."""
    if name == "library":  # former name of the module
        return import_module("tma_ray.api")
    if name not in LIBRARY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("tma_ray.api"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *LIBRARY})

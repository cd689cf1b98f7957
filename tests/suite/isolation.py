"""Plug-in that restores registries, environment variables, folder and generators after every case."""

import gc
import os
import random
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tma_ray.components.registry import Registry
from tma_ray.envs import ENVIRONMENTS
from tma_ray.students import STUDENTS
from tma_ray.teachers import TEACHERS

REGISTRIES: tuple[Registry, ...] = (TEACHERS, STUDENTS, ENVIRONMENTS)
KEPT = ("_decorated", "_origins", "_sources")


@pytest.fixture(autouse=True)
def _names_of_a_case() -> Iterator[None]:
    yield from _restored_registries()


@pytest.fixture(scope="module", autouse=True)
def _names_of_a_module() -> Iterator[None]:
    yield from _restored_registries()


def pytest_configure() -> None:
    """Disable garbage collection during imports, which saves a quarter of their time."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Check that collection registered no plug-ins, which all cases would see; enable garbage collection.

    What was imported and collected stays to the end; without `gc.freeze` every full collection would visit
    it, for half a second.
    """
    gc.freeze()
    gc.enable()
    known = [name for registry in REGISTRIES for name in registry._decorated]
    if known:
        raise pytest.UsageError(f"collecting made {known} known: import plug-ins within a fixture")


def _restored_registries() -> Iterator[None]:
    """Unregister the plug-ins of a case and their modules, which later cases may import again."""
    before = [{name: dict(vars(registry)[name]) for name in KEPT} for registry in REGISTRIES]
    modules = set(sys.modules)
    yield
    for registry, kept in zip(REGISTRIES, before, strict=True):
        for name in set(registry._origins.values()) - set(kept["_origins"].values()) - modules:
            sys.modules.pop(name, None)
        for name, entries in kept.items():
            vars(registry)[name].clear()
            vars(registry)[name].update(entries)


@pytest.fixture(autouse=True)
def _restored_surroundings() -> Iterator[None]:
    """Restore environment variables, working directory, arguments and import path."""
    variables, folder = dict(os.environ), Path.cwd()
    arguments, path = list(sys.argv), list(sys.path)
    yield
    os.chdir(folder)
    sys.argv[:], sys.path[:] = arguments, path
    for name in set(os.environ) - set(variables) - {"PYTEST_CURRENT_TEST"}:
        del os.environ[name]
    os.environ.update({name: value for name, value in variables.items() if os.environ.get(name) != value})


@pytest.fixture(autouse=True)
def _restored_generators() -> Iterator[None]:
    """Restore the global random generators, which no code of the project may use."""
    plain, arrays = random.getstate(), np.random.get_state()  # noqa: NPY002
    torch = sys.modules.get("torch")
    tensors = torch.get_rng_state() if torch else None
    yield
    random.setstate(plain)
    np.random.set_state(arrays)  # noqa: NPY002
    if torch:
        torch.set_rng_state(tensors)


@pytest.fixture(scope="session", autouse=True)
def _no_waiting_for_disks() -> Iterator[None]:
    """Disable fsync, which matters only after a power failure."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield

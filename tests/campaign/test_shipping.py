from __future__ import annotations

from pathlib import Path

import pytest

from tma_ray.campaign.cluster.base import FOLDER, MOST_BYTES, runtime_environment
from tma_ray.plugin_source import PluginSource

OWN = PluginSource("lab.maze", {"lab/__init__.py": b"", "lab/maze.py": b"x = 1"}, installed=False)
OTHER = PluginSource("alone", {"alone.py": b"", "lab/__init__.py": b""}, installed=False)
INSTALLED = PluginSource("pluggy", {"pluggy/__init__.py": b""}, installed=True)


def test_exactly_the_users_own_files_are_shipped() -> None:
    with runtime_environment([OWN, OTHER, INSTALLED]) as environment:
        assert environment is not None
        (folder,) = map(Path, environment["py_modules"])
        assert folder.name == FOLDER
        shipped = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*.py")}
        assert shipped == {**OWN.files, **OTHER.files}
    assert not folder.exists()


def test_nothing_is_shipped_where_all_is_installed() -> None:
    for sources in ([], [INSTALLED]):
        with runtime_environment(sources) as environment:
            assert environment is None


def test_large_files_are_refused_by_name() -> None:
    large = PluginSource("big", {"big.py": b"", "map.npy": bytes(MOST_BYTES + 1)}, installed=False)
    with (
        pytest.raises(ValueError, match=r"20 MiB \(map\.npy: 20 MiB\).*install them"),
        runtime_environment([large]),
    ):
        pass

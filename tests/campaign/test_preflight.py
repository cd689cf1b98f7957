"""What is checked before runs start: storage that all nodes see, files that are shipped, a living head."""

import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

from tma_ray.campaign import execution
from tma_ray.campaign.cluster.connection import MAX_SHIPPED_BYTES, PACKAGE, runtime_environment
from tma_ray.campaign.cluster.nodes import working_nodes
from tma_ray.components.plugin_source import PluginSource
from tma_ray.console.exit_codes import RAY_LOST
from tma_ray.results import ResultsRootError, Store


def other_disk(store: Store, probe: str | None) -> bool:
    """Answer as a worker on a machine with a disk of its own."""
    return execution.can_access(Store.open(f"{store.base} of another machine"), probe)


def as_two(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add a node of which Ray knows nothing: what is asked of it, this machine answers."""
    nodes: list[dict[str, Any]] = working_nodes()
    others = [node | {"NodeID": "e" * len(node["NodeID"])} for node in nodes]
    monkeypatch.setattr(execution, "working_nodes", lambda: nodes + others)


@pytest.mark.usefixtures("cluster")
@pytest.mark.slow
def test_a_folder_that_all_nodes_see_stays_empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    as_two(monkeypatch)
    execution.check_storage_access(Store.open(tmp_path / "root"))
    assert not [path for path in (tmp_path / "root").rglob("*") if path.is_file()]


@pytest.mark.usefixtures("cluster")
def test_a_folder_of_one_machine_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    as_two(monkeypatch)
    monkeypatch.setattr(execution, "can_access", other_disk)
    with pytest.raises(ResultsRootError, match=r"does not see this machine's .*root: choose a folder"):
        execution.check_storage_access(Store.open(tmp_path / "root"))


@pytest.mark.usefixtures("cluster")
def test_one_machine_is_not_asked(tmp_path: Path) -> None:
    execution.check_storage_access(Store.open(tmp_path / "root"))
    assert not (tmp_path / "root").exists()


OWN = PluginSource("lab.maze", {"lab/__init__.py": b"", "lab/maze.py": b"x = 1"}, installed=False)
OTHER = PluginSource("alone", {"alone.py": b"", "lab/__init__.py": b""}, installed=False)
INSTALLED = PluginSource("pluggy", {"pluggy/__init__.py": b""}, installed=True)


def test_exactly_the_users_own_files_are_shipped() -> None:
    with runtime_environment([OWN, OTHER, INSTALLED]) as environment:
        (folder,) = map(Path, environment["py_modules"])
        assert folder.name == PACKAGE
        shipped = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*.py")}
        assert shipped == {**OWN.files, **OTHER.files}
    assert not folder.exists()


def test_nothing_is_shipped_where_all_is_installed() -> None:
    for sources in ([], [INSTALLED]):
        with runtime_environment(sources) as environment:
            assert environment is None


def test_large_files_are_refused_by_name() -> None:
    large = PluginSource("big", {"big.py": b"", "map.npy": bytes(MAX_SHIPPED_BYTES + 1)}, installed=False)
    with (
        pytest.raises(ValueError, match=r"20 MiB \(map\.npy: 20 MiB\).*install them"),
        runtime_environment([large]),
    ):
        pass


DRIVER = """
    import time
    from tma_ray.campaign.cluster.protocols import exit_on_head_loss

    class Head:
        def failure_reason(self, patience):
            return "the head is gone" if HEAD_IS_LOST else None

        def kill(self):
            print("abandoned", flush=True)

    with exit_on_head_loss(Head(), "short"):
        time.sleep(WAIT)
    print("checked")
"""


def driver(wait: float, *, lost: bool) -> subprocess.CompletedProcess[str]:
    code = textwrap.dedent(DRIVER).replace("HEAD_IS_LOST", str(lost)).replace("WAIT", str(wait))
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)


def test_a_lost_head_ends_the_driver_with_a_message() -> None:
    ended = driver(1000, lost=True)
    assert (ended.returncode, ended.stdout) == (RAY_LOST, "abandoned\n")
    assert ended.stderr == ("short: the head is gone; no run had been started; give the same command again\n")


def test_a_head_that_is_there_is_left_alone() -> None:
    ended = driver(0, lost=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "checked\n", "")

"""Roots that not every node sees."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tma_ray.campaign import execution
from tma_ray.campaign.cluster.base import working_nodes
from tma_ray.results import ResultsRootError, Store

pytestmark = pytest.mark.usefixtures("cluster")


def other_disk(store: Store, probe: str | None) -> bool:
    """Answer as a worker on a machine with a disk of its own."""
    return execution.can_access(Store.open(f"{store.base} of another machine"), probe)


def as_two(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add a node of which Ray knows nothing: what is asked of it, this machine answers."""
    nodes: list[dict[str, Any]] = working_nodes()
    others = [node | {"NodeID": "e" * len(node["NodeID"])} for node in nodes]
    monkeypatch.setattr(execution, "working_nodes", lambda: nodes + others)


@pytest.mark.slow
def test_a_folder_that_all_nodes_see_is_used_and_nothing_is_left_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    as_two(monkeypatch)
    execution.check_storage_access(Store.open(tmp_path / "root"))
    assert not [path for path in (tmp_path / "root").rglob("*") if path.is_file()]


def test_a_folder_of_one_machine_is_refused_on_several(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    as_two(monkeypatch)
    monkeypatch.setattr(execution, "can_access", other_disk)
    with pytest.raises(ResultsRootError, match=r"does not see this machine's .*root: choose a folder"):
        execution.check_storage_access(Store.open(tmp_path / "root"))


def test_one_machine_is_not_asked(tmp_path: Path) -> None:
    execution.check_storage_access(Store.open(tmp_path / "root"))
    assert not (tmp_path / "root").exists()

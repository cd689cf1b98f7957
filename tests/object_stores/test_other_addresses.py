"""Baselines at addresses of fsspec: in memory, and behind a web server of this machine."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import fsspec
import pytest

from analysis.baselines import find_baseline
from tma_ray.results import DamagedFileWarning, ObjectStoreError, Results, Store, check_usable

ROOT = Path(__file__).parents[2] / "notebooks" / "data" / "ppo-lite"

MEMORY = "memory://other-addresses/ppo-lite"


class Quiet(SimpleHTTPRequestHandler):
    """A handler of requests that prints nothing."""

    def log_message(self, *_: object) -> None:
        return


@pytest.fixture(scope="module")
def served() -> Iterator[str]:
    """The address of the root at a web server."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(ROOT.parent))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/{ROOT.name}"
        server.shutdown()


@pytest.fixture
def memory() -> Iterator[str]:
    """The address of the root in memory."""
    filesystem = fsspec.filesystem("memory")
    filesystem.put(f"{ROOT}/", MEMORY, recursive=True)
    yield MEMORY
    filesystem.rm(MEMORY, recursive=True)


def measures(place: str | Path) -> list[float]:
    return find_baseline(place).frames().measured["mastered_percent"].tolist()


def test_a_baseline_in_memory_reads_as_on_disk(memory: str) -> None:
    assert measures(memory) == measures(ROOT)


def test_a_baseline_behind_a_web_server_reads_as_on_disk(served: str) -> None:
    pytest.importorskip("aiohttp")
    assert measures(served) == measures(ROOT)


def test_what_was_changed_there_is_named_and_left_out(memory: str) -> None:
    filesystem = fsspec.filesystem("memory")
    path = sorted(filesystem.glob(f"{MEMORY}/manifests/*.json"))[0]
    filesystem.pipe_file(path, filesystem.cat_file(path)[:-10])
    with pytest.warns(DamagedFileWarning, match=r"^memory://other-addresses/.*was left out"):
        assert len(Results.open(memory).runs()) == len(Results.open(ROOT).runs()) - 1


def test_an_unknown_address_is_refused_in_a_sentence() -> None:
    with pytest.raises(ObjectStoreError, match="Protocol not known: nothing"):
        Store.open("nothing://of/the/kind")


def test_campaigns_are_refused_where_nothing_can_be_written(served: str, memory: str) -> None:
    pytest.importorskip("aiohttp")
    with pytest.raises(ObjectStoreError, match="can only be read"):
        check_usable(Store.open(served))
    check_usable(Store.open(memory))

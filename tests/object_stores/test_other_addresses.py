"""Baselines at addresses of fsspec: in memory, behind a local web server, and at a local Hugging Face."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFile

from analysis.baselines import BaselineError, find_baseline, publish, release, verify
from analysis.baselines.catalogue import BASELINES_VARIABLE
from tests.object_stores.hub import Hub
from tests.object_stores.hub import served as served_hub
from tma_ray.cli import main
from tma_ray.results import (
    DamagedFileError,
    DamagedFileWarning,
    ObjectStoreError,
    Results,
    Store,
    check_usable,
)

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2] / "notebooks" / "data" / "ppo-lite"
MEMORY = "memory://other-addresses/ppo-lite"


class Quiet(SimpleHTTPRequestHandler):
    """A handler of requests that prints nothing."""

    def log_message(self, *_: object) -> None:
        return


@pytest.fixture(scope="module")
def served() -> Iterator[str]:
    """The address of the root at a web server."""
    pytest.importorskip("aiohttp")
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


@pytest.mark.parametrize("place", ["memory", "served"])
def test_a_baseline_elsewhere_reads_as_on_disk(request: pytest.FixtureRequest, place: str) -> None:
    assert measures(request.getfixturevalue(place)) == measures(ROOT)


def test_what_was_changed_there_is_named_and_left_out(memory: str) -> None:
    filesystem = fsspec.filesystem("memory")
    path = sorted(filesystem.glob(f"{MEMORY}/manifests/*.json"))[0]
    filesystem.pipe_file(path, filesystem.cat_file(path)[:-10])
    with pytest.warns(DamagedFileWarning, match=r"^memory://other-addresses/.*was left out"):
        assert len(Results.open(memory).runs()) == len(Results.open(ROOT).runs()) - 1


def test_an_unknown_address_is_refused_in_a_sentence() -> None:
    with pytest.raises(ObjectStoreError, match="Protocol not known: nothing"):
        Store.open("nothing://of/the/kind")


@pytest.mark.parametrize("address", ["hf://datasets/me/mine-1.0", "https://example.org/mine-1.0"])
def test_a_missing_library_is_named_with_its_extra(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for library in ("huggingface_hub", "aiohttp", "fsspec.implementations.http"):
        monkeypatch.setitem(sys.modules, library, None)
    for protocol in ("hf", "https"):  # which another test may have asked for
        monkeypatch.delitem(sys.modules["fsspec.registry"]._registry, protocol, raising=False)
    with pytest.raises(ObjectStoreError, match=r"pip install 'tma_ray\[addresses\]'"):
        Store.open(address)


class Refusing(Quiet):
    """A handler that refuses every request."""

    def do_GET(self) -> None:
        self.send_error(403)

    def do_HEAD(self) -> None:
        self.do_GET()


def test_a_place_that_refuses_or_is_gone_is_told_from_one_without_a_baseline(served: str) -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), Refusing) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/mine"
        with pytest.raises(ObjectStoreError, match=r"baseline\.json was refused: 403.*who may read there"):
            verify(address)
        server.shutdown()
    for read in (verify, find_baseline, Results.open):
        with pytest.raises(ObjectStoreError, match=r"cannot be reached: .*Connect call failed"):
            read(address)
    with pytest.raises(BaselineError, match=r"baseline\.json is missing"):
        verify(f"{served}/tables")


def test_a_lost_place_is_no_damage(packed: Path, published: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object) -> None:
        raise TimeoutError("no answer")

    assert verify(published).whole
    monkeypatch.setattr(MemoryFile, "read", lost)
    with pytest.raises(ObjectStoreError, match="cannot be reached: no answer"):
        verify(published)


def test_a_variable_may_name_a_folder_at_an_address(published: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(BASELINES_VARIABLE, published.rpartition("/")[0])
    assert find_baseline("mine-1.0").location == published


def test_campaigns_are_refused_where_nothing_can_be_written(served: str, memory: str) -> None:
    with pytest.raises(ObjectStoreError, match="can only be read"):
        check_usable(Store.open(served))
    check_usable(Store.open(memory))


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release with a file of several runs."""
    return release(ROOT, "mine-1.0", tmp_path_factory.mktemp("packed"))


@pytest.fixture
def published(packed: Path) -> Iterator[str]:
    """The address of the release in memory, where nothing was before."""
    address = "memory://published/mine-1.0"
    yield publish(packed, address)
    fsspec.filesystem("memory").rm("memory://published", recursive=True)


def test_a_published_release_reads_as_on_disk_and_is_never_overwritten(packed: Path, published: str) -> None:
    assert verify(published).whole
    assert measures(published) == measures(packed)
    with pytest.raises(BaselineError, match="never overwritten"):
        publish(packed, published)


def test_an_interrupted_upload_is_continued_among_its_own_files_only(packed: Path, published: str) -> None:
    filesystem = fsspec.filesystem("memory")
    filesystem.rm(f"{published}/baseline.json")  # the last to come
    filesystem.rm(f"{published}/root.json")
    assert verify(publish(packed, published)).whole
    filesystem.rm(f"{published}/baseline.json")
    filesystem.pipe_file(f"{published}/notes.txt", b"mine")
    with pytest.raises(BaselineError, match=r"1 files of something else, such as notes\.txt"):
        publish(packed, published)


def test_nothing_of_a_changed_file_is_shown(published: str) -> None:
    filesystem = fsspec.filesystem("memory")
    for path in filesystem.glob(f"{published}/tables/evaluations/*.parquet"):
        filesystem.pipe_file(path, filesystem.cat_file(path) + b"\0")
    with pytest.warns(DamagedFileWarning, match="its sha256 is not the recorded one"):
        frames = find_baseline(published).frames()
    assert frames.evaluations.empty
    assert frames.skipped_files
    filesystem.pipe_file(f"{published}/README.md", b"another card")
    with pytest.raises(DamagedFileError, match=r"README\.md is damaged: its sha256"):
        find_baseline(published).store().read_bytes("README.md")


def test_where_nothing_can_be_written_none_is_packed(served: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["release", str(ROOT), "mine-1.0", "--output", served]) == 2
    assert "can only be read" in capsys.readouterr().err


def test_the_command_publishes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = (tmp_path / "place").as_uri()
    assert main(["release", str(ROOT), "mine-1.0", "--lean", "--output", place]) == 0
    assert capsys.readouterr().out.strip() == f"{place}/mine-1.0"
    assert verify(tmp_path / "place" / "mine-1.0").whole
    assert main(["release", str(ROOT), "mine-1.0", "--shard", "one", "--output", place]) == 2
    assert "--shard adds to a release in a folder" in capsys.readouterr().err


pytest.importorskip("huggingface_hub")


DATA_SET = Path(__file__).parents[2] / "notebooks" / "data" / "ppo-lite"
ADDRESS = "hf://datasets/me/mine-1.0"


def command(hub: Hub, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the command in a process whose library knows `hub` and no other."""
    environment = os.environ | {"HF_ENDPOINT": hub.address, "HF_TOKEN": "secret", "COLUMNS": "80"}
    words = [sys.executable, "-m", "tma_ray", *map(str, arguments)]
    return subprocess.run(words, env=environment, capture_output=True, text=True, check=False)


def test_a_release_is_published_verified_and_read() -> None:
    with served_hub() as hub:
        hub.repositories["me/mine-1.0"] = {".gitattributes": b"*.parquet filter=lfs\n"}
        published = command(hub, "release", DATA_SET, "mine-1.0", "--output", "hf://datasets/me")
        assert (published.returncode, published.stdout.strip()) == (0, ADDRESS), published.stderr
        whole = command(hub, "baselines", "verify", ADDRESS)
        assert whole.returncode == 0, whole.stdout + whole.stderr
        read = command(hub, "ranking", ADDRESS)
        assert (read.returncode, read.stdout) == (0, command(hub, "ranking", DATA_SET).stdout)
        hub.repositories["me/mine-1.0"]["README.md"] += b"another"
        changed = command(hub, "baselines", "verify", ADDRESS)
        assert changed.returncode == 1
        assert "README.md" in changed.stdout + changed.stderr


def test_a_hub_that_refuses_and_one_that_is_gone_are_told_from_an_empty_place() -> None:
    with served_hub() as hub:
        hub.repositories["me/mine-1.0"] = {"README.md": b"a card"}
        empty = command(hub, "baselines", "verify", ADDRESS)
        private = command(hub, "baselines", "verify", "hf://datasets/me/private")
    gone = command(hub, "baselines", "verify", ADDRESS)
    assert [each.returncode for each in (empty, private, gone)] == [2, 2, 2]
    assert f"{ADDRESS} is not a baseline: baseline.json is missing" in empty.stderr
    assert "hf://datasets/me/private/baseline.json was refused: 401" in private.stderr
    assert f"{ADDRESS}/baseline.json cannot be reached" in gone.stderr
    assert "secret" not in private.stderr + gone.stderr

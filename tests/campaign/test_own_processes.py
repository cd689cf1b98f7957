"""A campaign's own Ray: the processes that it cannot do without, and where it puts its files."""

import shutil
import stat
import subprocess
import sys
from pathlib import Path
from subprocess import PIPE, Popen

import psutil
import pytest

from tma_ray.campaign.cluster.connection import MARK, MAX_PARENT_BYTES, LocalRayWatch, private_folder


def test_children_of_the_node_manager_may_end_and_the_node_manager_may_not(tmp_path: Path) -> None:
    """Until they are workers, they bear its name."""
    bash = shutil.which("bash")
    assert bash is not None
    raylet = shutil.copy(bash, tmp_path / "raylet")
    processes = LocalRayWatch()
    command = [raylet, "-c", f"{raylet} -c 'echo; read line'; echo; read line"]
    with Popen(command, stdin=PIPE, stdout=PIPE, text=True) as node:
        node.stdout.readline()
        (child,) = psutil.Process(node.pid).children()
        assert child.name() == "raylet"
        assert processes.failure_reason() is None
        node.stdin.write("\n")
        node.stdin.flush()
        node.stdout.readline()
        assert not child.is_running()
        assert processes.failure_reason() is None
        node.kill()
        node.wait()
        assert "node manager (raylet)" in str(processes.failure_reason())


def test_what_has_closed_its_ports_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the head is after SIGTERM: it neither serves nor ends."""
    monkeypatch.setattr("tma_ray.campaign.cluster.connection.HEAD_CHECK_SECONDS", 0.0)
    python = tmp_path / "gcs_server"
    python.symlink_to(sys.executable)
    processes = LocalRayWatch()
    code = (
        "import socket, sys; sys.stdin.readline(); server = socket.create_server(('127.0.0.1', 0))\n"
        "print(flush=True); sys.stdin.readline(); server.close(); print(flush=True); sys.stdin.readline()"
    )
    with Popen([python, "-c", code], stdin=PIPE, stdout=PIPE, text=True) as head:
        assert processes.failure_reason() is None, "it has not begun to serve"
        for lost in (False, True):
            head.stdin.write("\n")
            head.stdin.flush()
            head.stdout.readline()
            assert ("head (GCS)" in str(processes.failure_reason())) is lost
        assert head.poll() is None
        head.kill()


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A short one: sockets have to fit."""
    monkeypatch.delenv("RAY_TMPDIR", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("tma_ray.campaign.cluster.connection.MAX_PARENT_BYTES", len(str(tmp_path)))
    return tmp_path


def abandoned(place: Path) -> Path:
    """Return the folder of a process that was killed."""
    code = (
        f"import os, tempfile; tempfile.tempdir = {str(place)!r}\n"
        "from tma_ray.campaign.cluster import connection\n"
        f"connection.MAX_PARENT_BYTES = {len(str(place))}\n"
        "folder = connection.private_folder()\n"
        "(folder / 'ray' / 'logs').mkdir(parents=True)\n"
        "print(folder, flush=True); os._exit(1)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.stdout, ended.stderr
    return Path(ended.stdout.strip())


def test_is_of_the_user_alone_and_of_one_ray(temporary: Path) -> None:
    first, second = private_folder(), private_folder()
    assert first != second
    for folder in (first, second):
        assert folder.parent == temporary
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_is_removed_by_the_next_campaign_once_its_process_has_ended(temporary: Path) -> None:
    kept, left = private_folder(), abandoned(temporary)
    assert left.is_dir()
    private_folder()
    assert not left.exists()
    assert kept.is_dir(), "its process lives"


@pytest.mark.parametrize("trap", ["link", "link within", "no mark", "more than Ray's"])
def test_what_is_not_ours_is_left_where_it_is(temporary: Path, trap: str) -> None:
    users = temporary / "users"
    (users / "ray").mkdir(parents=True)
    (users / MARK).touch()
    (users / "ray" / "thesis.txt").write_text("years")
    place = temporary / "tma_ray-12345678"
    if trap == "link":
        place.symlink_to(users)
    else:
        place.mkdir()
        (place / "notes.txt").write_text("the user's")
        if trap != "no mark":
            (place / MARK).touch()
        if trap == "link within":
            (place / "ray").symlink_to(users / "ray")
    folder = private_folder()
    assert folder is not None
    assert folder not in (place, users)
    assert (users / "ray" / "thesis.txt").read_text() == "years"
    assert place.is_symlink() or (place / "notes.txt").read_text() == "the user's"


def test_places_too_long_for_sockets_are_not_used(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tma_ray.campaign.cluster.connection.MAX_PARENT_BYTES", MAX_PARENT_BYTES)
    long = temporary / ("long" * 10)
    long.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(long))
    folder = private_folder()
    assert folder.parent == Path("/tmp")
    (folder / MARK).unlink()
    folder.rmdir()


def test_what_the_user_chooses_is_left_to_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_TMPDIR", "/somewhere")
    assert private_folder() is None

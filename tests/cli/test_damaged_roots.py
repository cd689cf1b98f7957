"""Every command on a root with something else in the place of a file: it is named, and the rest is read."""

import contextlib
import ctypes
import itertools
import os
import shutil
import socket
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tma_ray.cli import main

OLD_ROOT = Path(__file__).parents[1] / "compatibility" / "version_1" / "root"
RUN = "ppo_alp_gmm-s0-5e7c73111b9c"
MANIFEST, TABLE, ROOT_FILE = f"manifests/{RUN}.json", f"tables/evaluations/{RUN}.parquet", "root.json"


def _socket(path: Path) -> None:
    with contextlib.chdir(path.parent), socket.socket(socket.AF_UNIX) as server:  # their paths are short
        server.bind(path.name)


IN_PLACE: dict[str, Callable[[Path], object]] = {
    "nothing": lambda path: None,
    "a folder": Path.mkdir,
    "a pipe": os.mkfifo,
    "a socket": _socket,
    "a link to nowhere": lambda path: path.symlink_to("nowhere"),
    "a circle of links": lambda path: path.symlink_to(path.name),
    "a link to a device": lambda path: path.symlink_to("/dev/zero"),
    "a file of holes": lambda path: (path.touch(), os.truncate(path, 300 * 2**30)),
}

COMMANDS = {
    "verify": (1, ()),
    **dict.fromkeys(("status", "ranking", "compact"), (0, ())),
    "report": (0, ("-o", "page")),
    "compare": (0, ("--baseline", "paper-2021", "-o", "page")),
    "release": (2, ("released",)),
}
"""Exit code on a damaged root, and what follows the root."""


def cases(first: Iterable[str], second: Iterable[str], fast: tuple[str, str]) -> list[Any]:
    """Return all pairs, of which those without any of `fast` are slow: a row and a column say most."""
    return [
        pytest.param(*pair, marks=() if set(pair) & set(fast) else pytest.mark.slow)
        for pair in itertools.product(first, second)
    ]


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(OLD_ROOT, tmp_path / "root"))


@pytest.mark.parametrize(("command", "kind"), cases(COMMANDS, IN_PLACE, ("verify", "a pipe")))
def test_non_files_are_named(root: Path, command: str, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, more = COMMANDS[command]
    for path in (MANIFEST, f"policies/{RUN}/spec.json", "heartbeat.json"):
        (root / path).unlink(missing_ok=True)
        IN_PLACE[kind](root / path)
    assert main([command, str(root), *more]) == code
    said = "".join(capsys.readouterr())
    assert MANIFEST in said
    assert "Traceback" not in said


@pytest.mark.parametrize("kind", IN_PLACE)
@pytest.mark.parametrize(("command", "path"), [("verify", TABLE), ("ranking", TABLE), ("status", ROOT_FILE)])
def test_so_are_tables_and_what_marks_a_root(root, command, path, kind, capsys):
    (root / path).unlink()
    IN_PLACE[kind](root / path)
    assert main([command, str(root)]) == COMMANDS[command][0]
    assert path in "".join(capsys.readouterr())


@pytest.mark.parametrize("kind", ["nothing", "a pipe"])
def test_a_release_leaves_it_out(root: Path, kind: str, tmp_path: Path) -> None:
    (root / MANIFEST).unlink()
    IN_PLACE[kind](root / MANIFEST)
    assert main(["release", str(root), "released", "--partial"]) == 0
    assert MANIFEST in (tmp_path / "released" / "README.md").read_text()


@pytest.fixture
def unprivileged() -> Iterator[None]:
    """Take the right to read everything from root, for the time of a test; others never had it."""
    if sys.platform != "linux":
        if os.geteuid() == 0:
            pytest.skip("root reads everything here")
        yield
        return
    libc, header, sets = ctypes.CDLL(None), (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
    assert libc.capget(header, sets) == 0
    before = sets[0]
    sets[0] = before & ~0b110  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
    assert libc.capset(header, sets) == 0
    yield
    sets[0] = before
    assert libc.capset(header, sets) == 0


@pytest.mark.usefixtures("unprivileged")
@pytest.mark.parametrize(
    ("command", "path"),
    cases(
        ["verify", "status", "report", "compare"],
        [MANIFEST, TABLE, f"policies/{RUN}", "tables/cells", "."],
        ("verify", TABLE),
    ),
)
def test_what_may_not_be_read_gives_a_sentence(root, command, path, capsys):
    mode = (root / path).stat().st_mode
    (root / path).chmod(0)
    code = main([command, str(root), *COMMANDS[command][1]])
    (root / path).chmod(mode)
    said = "".join(capsys.readouterr())
    assert code in (0, 1, 2)
    assert "Traceback" not in said
    if code or path == MANIFEST:
        assert str(root / path) in said or path in said

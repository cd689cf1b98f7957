"""A results root carries our mark; what others keep in it, or where its links lead to, is never touched."""

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from results_examples import OLD_ROOT, add_run

from tma_ray.results import (
    Committer,
    Lease,
    Results,
    ResultsRootError,
    Store,
    Table,
    ask_to_stop,
    check_usable,
    compact,
    create_root,
    start_from,
    verify_root,
)
from tma_ray.results.committer import TEMPORARY_SECONDS
from tma_ray.results.compaction import JOURNAL
from tma_ray.results.layout import CHECKPOINTS, FOLDERS, STAGING
from tma_ray.support.decoding import DamagedFileError, DamagedFileWarning

ACCESSES: dict[str, Callable[[Store], object]] = {
    "read": lambda store: store.read_bytes("link/file"),
    "write": lambda store: store.write_bytes("link/file", b"ours"),
    "create": lambda store: store.create("link/new", b"ours"),
    "move from": lambda store: store.move("link/file", "taken"),
    "move to": lambda store: store.move("ours", "link/file"),
    "delete file": lambda store: store.delete("link/file"),
    "delete folder": lambda store: store.delete("link/folder"),
}

MAKERS: dict[str, Callable[[Store], object]] = {
    "check_usable": check_usable,
    "create_root": create_root,
    "Committer": Committer,
    "start_from": lambda store: start_from(store, Store.open(OLD_ROOT)),
    "Lease": lambda store: Lease(store, "campaign").acquire(),
}


def aged(path: Path, text: str | None = None) -> Path:
    """Make a file or link two hours old, having written `text` to it if there is one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if text is not None:
        path.write_text(text)
    os.utime(path, (time.time() - 2 * TEMPORARY_SECONDS,) * 2, follow_symlinks=False)
    return path


def put(folder: Path, theirs: str) -> None:
    if theirs.endswith("/"):
        (folder / theirs).mkdir(parents=True)
    else:
        aged(folder / theirs, "theirs")


def contents(folder: Path) -> dict[str, str]:
    """Return all that lies below a folder: the text of files, links as such, empty texts of folders."""

    def content(path: Path) -> str:
        if path.is_symlink():
            return f"-> {path.readlink()}"
        return path.read_text(errors="replace") if path.is_file() else ""

    return {path.relative_to(folder).as_posix(): content(path) for path in sorted(folder.rglob("*"))}


def finished(place: Path) -> Committer:
    committer = Committer.open(place)
    add_run(committer.store)
    return committer


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A folder of somebody else, whose files are old."""
    for name in ("file", "folder/file"):
        aged(tmp_path / "outside" / name, "theirs")
    return tmp_path / "outside"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    create_root(Store.open(tmp_path / "root"))
    return tmp_path / "root"


@pytest.mark.parametrize(
    "theirs",
    ["tmp/notes.txt", "tmp/0123456789abcdef0123456789abcdef", "tmp/folder/", "empty/", "lease.json", "tmp"],
)
@pytest.mark.parametrize("make", [MAKERS[name] for name in MAKERS if name != "Lease"])
def test_a_folder_that_holds_anything_of_others_does_not_become_a_root(tmp_path, theirs, make):
    put(tmp_path, theirs)
    before = contents(tmp_path)
    refusal = rf"neither empty \({theirs.split('/')[0]}.*choose a new or empty"
    with pytest.raises(ResultsRootError, match=refusal):
        make(Store.open(tmp_path))
    assert contents(tmp_path) == before


@pytest.mark.parametrize("theirs", [".DS_Store", "._results", ".Trashes/a", "lost+found/", "tmp/.DS_Store"])
@pytest.mark.parametrize("make", [MAKERS[name] for name in MAKERS if name != "Lease"])
def test_a_folder_with_nothing_but_files_of_its_system_becomes_a_root(tmp_path, theirs, make):
    put(tmp_path, theirs)
    before = contents(tmp_path)
    make(Store.open(tmp_path))
    assert contents(tmp_path).items() >= before.items()


def test_files_of_the_system_in_a_root_are_nothing_of_ours(tmp_path: Path) -> None:
    """macOS writes .DS_Store into folders that are looked at, and ._NAME beside files that are copied."""
    root = shutil.copytree(OLD_ROOT, tmp_path / "root")
    store = Store.open(root)
    before, rows = verify_root(store), Results(store).table(Table.EVALUATIONS).num_rows
    paths = [path for path in sorted(root.rglob("*")) if path.is_file()]
    for path in paths:
        path.with_name(f"._{path.name}").write_bytes(b"\x00\x05\x16\x07")
    for folder in {path.parent for path in paths}:
        (folder / ".DS_Store").write_bytes(b"Bud1")
    assert verify_root(store) == before
    assert Results(store).table(Table.EVALUATIONS).num_rows == rows
    compact(root)
    assert not verify_root(store).damage


def test_a_link_that_leads_nowhere_is_something(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(ResultsRootError, match=r"neither empty \(link\)"):
        create_root(Store.open(tmp_path))


def test_the_sweep_deletes_what_is_ours_and_old_and_nothing_else(root: Path, outside: Path) -> None:
    committer = Committer.open(root)
    file, folder, link, young = (root / committer.store.temporary() for _ in range(4))
    aged(file, "half")
    aged(folder / "inner", "half")
    aged(folder)
    link.symlink_to(outside)
    aged(link)
    young.write_text("half")
    stays = {
        "notes.txt": "theirs",
        "0123456789abcdef0123456789abcdef": "of a root without marks",
        f"{file.name}.bak": "theirs",
        f"tma_ray-{root.stat().st_ino + 1}-{file.name.rpartition('-')[2]}": "of another root",
    }
    for name, text in stays.items():
        aged(root / "tmp" / name, text)
    (root / "tmp" / "folder").mkdir()
    aged(root / "tmp" / "folder")
    committer.sweep()
    assert contents(root / "tmp") == {**stays, young.name: "half", "folder": ""}
    assert contents(outside) == {"file": "theirs", "folder": "", "folder/file": "theirs"}


@pytest.mark.parametrize("access", ACCESSES.values(), ids=ACCESSES)
def test_nothing_goes_through_a_link_out_of_the_root(root, outside, access):
    store = Store.open(root)
    store.write_bytes("ours", b"ours")
    (root / "link").symlink_to(outside)
    before = contents(outside)
    refusal = r"root/link.* is damaged: a symbolic link leads out of the root"
    with pytest.raises(DamagedFileError, match=refusal):
        access(store)
    assert contents(outside) == before
    assert store.read_bytes("ours") == b"ours"


def test_a_link_that_stays_in_the_root_is_followed(root: Path) -> None:
    store = Store.open(root)
    store.write_bytes("here/file", b"old")
    (root / "link").symlink_to(root / "here")
    store.write_bytes("link/file", b"new")
    assert store.read_bytes("here/file") == store.read_bytes("link/file") == b"new"


@pytest.mark.parametrize("target", ["file", "folder", "nowhere"])
def test_of_a_link_only_the_link_is_deleted_or_replaced(root: Path, outside: Path, target: str) -> None:
    store, before = Store.open(root), contents(outside)
    for path in ("deleted", "replaced", "below/link"):
        store.write_bytes(f"{path}.ours", b"ours")
        (root / path).symlink_to(outside / target)
    store.delete("deleted")
    store.delete("below")
    store.write_bytes("replaced", b"ours")
    assert contents(outside) == before
    assert not (root / "deleted").is_symlink()
    assert not (root / "below").exists()
    assert contents(root / "tmp") == {}
    assert store.read_bytes("replaced") == b"ours"


@pytest.mark.parametrize("folder", FOLDERS)
@pytest.mark.parametrize("marked", [True, False], ids=["root", "no root"])
def test_folders_that_lead_out_are_refused(tmp_path: Path, outside: Path, folder: str, marked: bool) -> None:
    place = tmp_path / "root"
    place.mkdir()
    if marked:
        create_root(Store.open(place))
        shutil.rmtree(place / "tmp")
    (place / folder).symlink_to(outside)
    before = contents(outside), contents(place)
    for make in (check_usable, Committer):
        with pytest.raises(DamagedFileError, match=f"root/{folder} is damaged: a symbolic link leads out"):
            make(Store.open(place))
    assert (contents(outside), contents(place)) == before


@pytest.mark.parametrize("place", [STAGING, CHECKPOINTS])
def test_the_sweep_of_a_run_deletes_links_of_its_name(tmp_path: Path, outside: Path, place: str) -> None:
    committer = finished(tmp_path / "root")
    (tmp_path / "root" / place).mkdir(exist_ok=True)
    link, before = tmp_path / "root" / place / "run-1", contents(outside)
    link.symlink_to(outside)
    committer.sweep()
    assert not link.is_symlink()
    assert contents(tmp_path / "root" / "tmp") == {}
    assert contents(outside) == before


@pytest.fixture(params=["root of the file system", "home", "git", "source"])
def common(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that belongs to more than results."""
    monkeypatch.chdir(tmp_path)  # which the root of the file system was once taken for
    if request.param == "root of the file system":
        return Path("/")
    if request.param == "home":
        monkeypatch.setenv("HOME", str(tmp_path / "linked"))
    elif request.param == "git":
        (tmp_path / ".git").write_text("gitdir: elsewhere")  # as a working tree beside the first has it
    else:
        (tmp_path / "pyproject.toml").write_text("")
    (tmp_path.parent / f"{tmp_path.name}-linked").symlink_to(tmp_path)
    if request.param == "home":
        monkeypatch.setenv("HOME", str(tmp_path.parent / f"{tmp_path.name}-linked"))
    return tmp_path


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_shared_folders_become_no_root(common: Path, tmp_path: Path, make: Callable[[Store], object]) -> None:
    before = contents(tmp_path)
    refusal = r"(file system|home folder|checkout): results need a folder of "
    with pytest.raises(ResultsRootError, match=refusal):
        make(Store.open(common))
    assert contents(tmp_path) == before
    assert not Path("/root.json").exists()


def test_a_root_in_a_folder_of_more_than_results_is_read_and_not_written(tmp_path: Path) -> None:
    finished(tmp_path)
    (tmp_path / ".git").mkdir()
    before = contents(tmp_path)
    assert [manifest.run.run_id for manifest in Results.open(tmp_path).runs()] == ["run-1"]
    for action in (compact, Committer.open, lambda place: check_usable(Store.open(place))):
        with pytest.raises(ResultsRootError, match="is the top of a source checkout"):
            action(tmp_path)
    assert contents(tmp_path) == before
    below = tmp_path / "results"
    create_root(Store.open(below))
    assert (below / "root.json").exists()


def test_an_old_root_without_marks_is_read_and_continued(tmp_path: Path) -> None:
    shutil.copytree(OLD_ROOT, tmp_path / "root")
    left = aged(tmp_path / "root" / "tmp" / "0123456789abcdef0123456789abcdef", "half")
    runs = len(Results.open(tmp_path / "root").runs())
    committer = finished(tmp_path / "root")
    committer.sweep()
    results = Results(committer.store)
    assert len(results.runs()) == runs + 1
    assert len(results.table(Table.EVALUATIONS, ["run-1"])) > 0
    assert left.read_text() == "half"


@pytest.mark.parametrize("name", ["notes.parquet", "root.json", "tables/evaluations", "tables/a/b/c.parquet"])
def test_a_journal_of_others_deletes_no_other_files(tmp_path: Path, name: str) -> None:
    store = finished(tmp_path).store
    if not (tmp_path / name).exists():
        store.write_bytes(name, b"theirs")
    store.write_bytes(JOURNAL, f'{{"unless_used": [], "replaced": ["{name}"]}}'.encode())
    with pytest.warns(DamagedFileWarning, match=r"compacting\.json is damaged.*expected a file of a table"):
        compact(tmp_path)
    assert (tmp_path / name).exists()


def test_nobody_is_asked_to_stop_through_a_link(root: Path, outside: Path) -> None:
    with Lease(Store.open(root), "campaign"):
        (root / "stop.json").symlink_to(outside / "file")
        ask_to_stop(Store.open(root))
    assert contents(outside)["file"] == "theirs"
    assert not (root / "stop.json").is_symlink()

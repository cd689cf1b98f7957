"""What every store does; which places are roots."""

import errno
import json
import os
import pickle
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
from fsspec.implementations.arrow import ArrowFSWrapper
from pyarrow import fs
from results_examples import add_run

from tma_ray.results import (
    Committer,
    Lease,
    Results,
    ResultsRootError,
    RootInUseError,
    StorageError,
    Store,
    check_id,
    create_root,
    verify_root,
)
from tma_ray.results.storage import AddressStore


def test_files_are_written_replaced_listed_and_deleted(store: Store) -> None:
    store.write_bytes("a/b/one", b"1")
    store.write_bytes("a/b/one", b"11")
    store.write_bytes("a/two", b"2")
    assert store.read_bytes("a/b/one") == b"11"
    assert store.files() == store.files("a") == ("a/b/one", "a/two")
    assert store.files("missing") == ()
    assert store.exists("a/two")
    assert not store.exists("a/b")
    assert not store.exists("missing")
    store.delete("a/b")
    store.delete("missing")
    assert store.files() == ("a/two",)
    store.delete("a/two")
    assert not store.exists("a/two")


def test_move_replaces_what_is_there(store: Store) -> None:
    store.write_bytes("old/file", b"new")
    store.write_bytes("there/file", b"old")
    store.move("old/file", "there/file")
    store.move("there/file", "elsewhere/file")
    assert store.files() == ("elsewhere/file",)
    assert store.read_bytes("elsewhere/file") == b"new"


def test_reading_and_moving_what_is_not_there_says_so(store: Store) -> None:
    with pytest.raises(FileNotFoundError):
        store.read_bytes("missing")
    with pytest.raises(FileNotFoundError):
        store.move("missing", "anywhere")


def test_of_two_conditional_writes_the_second_is_refused(store: Store) -> None:
    assert store.create("file", b"first")
    assert not store.create("file", b"second")
    content, version = store.read_version("file")
    assert content == b"first"
    assert store.replace("file", b"third", version)
    assert not store.replace("file", b"fourth", version)
    assert store.read_bytes("file") == b"third"
    store.delete("file")
    assert not store.replace("file", b"fifth", version)
    assert not store.exists("file")


@pytest.mark.parametrize("path", ["", ".", "/etc/passwd", "../out", "a/../../out", "a\\..\\out"])
def test_paths_that_leave_the_root_are_refused(store: Store, path: str) -> None:
    with pytest.raises(ValueError, match="inside the root"):
        store.write_bytes(path, b"")


def test_a_compressed_file_is_read_as_it_is(store: Store) -> None:
    store.write_bytes("archive.gz", b"not compressed at all")
    assert store.read_bytes("archive.gz") == b"not compressed at all"


def test_a_write_that_fails_leaves_the_old_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store.open(tmp_path)
    store.write_bytes("file", b"old")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match=r"/file: free some space.*No space left.*continues from there"):
        store.write_bytes("file", b"new")
    assert store.read_bytes("file") == b"old"
    assert store.files() == ("file",)


def test_a_file_in_the_making_is_never_in_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store.open(tmp_path)
    seen = []
    sync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: (seen.append(store.files("tables")), sync(fd)))
    store.write_bytes("tables/file", b"x")
    assert seen[0] == ()
    assert seen[-1] == ("tables/file",)


def test_a_store_can_be_sent_to_another_process(tmp_path: Path) -> None:
    store = Store.open(tmp_path)
    store.write_bytes("file", b"x")
    assert pickle.loads(pickle.dumps(store)).read_bytes("file") == b"x"


def test_the_root_may_be_that_of_the_file_system(tmp_path: Path) -> None:
    store = AddressStore(ArrowFSWrapper(fs.SubTreeFileSystem(str(tmp_path), fs.LocalFileSystem())), "")
    store.write_bytes("a/b", b"x")
    store.move("a/b", "c/d")
    assert store.files() == store.files("c") == ("c/d",)
    assert store.read_bytes("c/d") == b"x"
    assert store.read_parts("c/d", lambda file: (file.size(), file.read())) == (1, b"x")


def test_a_uri_may_name_a_folder(tmp_path: Path) -> None:
    assert Store.open(tmp_path.as_uri()).base == str(tmp_path)


def test_an_empty_place_becomes_a_root_once_whatever_a_kill_has_left(store: Store) -> None:
    store.write_bytes(store.temporary(), b"{")
    create_root(store)
    content = store.read_bytes("root.json")
    create_root(store)
    assert store.read_bytes("root.json") == content


def test_other_files_are_never_taken_for_a_root(store: Store) -> None:
    store.write_bytes("thesis.tex", b"")
    with pytest.raises(ResultsRootError, match=r"thesis\.tex"):
        Committer(store)
    with pytest.raises(ResultsRootError, match="not a results root"):
        Results(store)
    assert store.files() == ("thesis.tex",)


def test_another_version_is_refused_naming_both(store: Store) -> None:
    content = {"format": "tma_ray results", "schema_version": 99}
    store.write_bytes("root.json", json.dumps(content).encode())
    for opens in (Committer, Results):
        with pytest.raises(ResultsRootError, match=r"version 99; .* version 1"):
            opens(store)


@pytest.mark.parametrize("content", [b"", b"[]", b"{}", b'{"format": "other", "schema_version": 1}'])
def test_a_damaged_or_foreign_root_file_is_refused(store: Store, content: bytes) -> None:
    store.write_bytes("root.json", content)
    with pytest.raises(ResultsRootError, match=r"root\.json"):
        Results(store)


@pytest.mark.parametrize("name", ["", "..", "a/b", "a.b", "a b", "é", "a\n"])
def test_ids_that_are_no_file_names_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="file names"):
        check_id(name)


NO_LINKS = (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EINVAL)


def without_links(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    monkeypatch.setattr(os, "link", refusing(number))


def without_folder_sync(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    sync = os.fsync

    def fsync(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(number, os.strerror(number))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)


@pytest.mark.parametrize("number", NO_LINKS, ids=errno.errorcode.get)
@pytest.mark.parametrize("no_sync", [errno.EINVAL, errno.EBADF, errno.ENOTSUP], ids=errno.errorcode.get)
def test_a_root_is_made_leased_written_and_read(tmp_path, monkeypatch, number, no_sync):
    without_links(monkeypatch, number)
    without_folder_sync(monkeypatch, no_sync)
    store = Store.open(tmp_path / "new/root")
    create_root(store)
    with Lease(store, "the first"):
        with pytest.raises(RootInUseError, match="the first"):
            Lease(store, "the second").acquire()
        add_run(store, "a-run")
    assert verify_root(store).damage == ()
    assert [each.run.run_id for each in Results(store).runs()] == ["a-run"]
    with Lease(store, "the second"):
        pass
    assert list((tmp_path / "new/root/tmp").iterdir()) == []


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC], ids=errno.errorcode.get)
def test_a_folder_that_is_not_synced_for_another_reason_is_an_error(tmp_path, monkeypatch, number):
    without_folder_sync(monkeypatch, number)
    with pytest.raises(StorageError, match="the same command continues"):
        Store.open(tmp_path / "root").write_bytes("file", b"1")


def refusing(number: int) -> Callable[..., None]:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    return refuse


def test_a_name_that_cannot_be_given_stays_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_links(monkeypatch, errno.EPERM)
    store = Store.open(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", refusing(errno.ENOSPC))
        with pytest.raises(StorageError, match="free some space"):
            store.create("lease.json", b"1")
    assert store.create("lease.json", b"2")
    assert not store.create("lease.json", b"3")
    assert store.read_bytes("lease.json") == b"2"


def test_what_no_repetition_mends_is_not_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", refusing(errno.EINVAL))
    lacking = r"file system lacks an operation.*use a folder on another"
    with pytest.raises(StorageError, match=lacking) as info:
        Store.open(tmp_path).write_bytes("file", b"1")
    assert "the same command" not in str(info.value)

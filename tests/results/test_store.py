import errno
import os
import pickle
from pathlib import Path

import pytest
from fsspec.implementations.arrow import ArrowFSWrapper
from pyarrow import fs

from tma_ray.results import StorageError, Store
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


def test_uris_name_buckets_and_folders(tmp_path: Path) -> None:
    store = Store.open("gs://bucket/some/folder")
    assert store.full_path("a/b") == "bucket/some/folder/a/b"
    assert store.where("a/b") == "gs://bucket/some/folder/a/b"
    assert Store.open(tmp_path.as_uri()).base == str(tmp_path)

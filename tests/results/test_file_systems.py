"""Roots on file systems that cannot sync a folder (CIFS, vboxsf) or have no hard links (exFAT, SMB)."""

import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
from results_examples import add_run

from tma_ray.results import Lease, Results, RootInUseError, StorageError, Store, create_root, verify_root

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
def test_a_root_is_made_leased_written_and_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, no_sync: int
) -> None:
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
def test_a_folder_that_is_not_synced_for_another_reason_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
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

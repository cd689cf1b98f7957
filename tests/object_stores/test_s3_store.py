"""A bucket on a real server: whole objects, patience, plain errors, few requests."""

import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from itertools import pairwise

import pytest
from s3_proxy import Proxy

from tma_ray.results import ObjectStoreError, Results, Store, check_usable
from tma_ray.results.storage import bucket

LARGE = bytes(11_000_000)
"""Two parts of an upload."""

PARTS = [pytest.param(f"partNumber={part}", marks=pytest.mark.slow) for part in (1, 2)]


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bucket, "ATTEMPTS", 2)


def test_requests_are_few(s3_root: str, proxy: Proxy) -> None:
    store = Store.open(s3_root)
    for action, most in (
        (lambda: store.write_bytes("a", b"small"), 1),
        (lambda: store.write_bytes("b", LARGE), 4),
        (lambda: store.read_bytes("b"), 1),
        (lambda: store.exists("a"), 1),
        (lambda: store.files(), 1),
        (lambda: store.move("a", "c"), 2),
        (lambda: store.delete("c"), 2),
    ):
        proxy.seen.clear()
        action()
        assert len(proxy.seen) <= most, proxy.seen


@pytest.mark.parametrize("fault", ["refuse", pytest.param("drop", marks=pytest.mark.slow)])
def test_throttling_and_lost_connections_are_waited_out(s3_root: str, proxy: Proxy, fault: str) -> None:
    store = Store.open(s3_root)
    left = dict.fromkeys(("PUT", "GET", "HEAD", "POST"), 2)

    def strike(method: str, path: str) -> bool:
        left[method] -= 1
        return left[method] >= 0

    setattr(proxy, fault, strike)
    store.write_bytes("file", b"content")
    assert store.read_bytes("file") == b"content"
    assert store.files() == ("file",)
    assert store.exists("file")
    store.delete("file")
    assert max(left.values()) < 0, "every kind of request was struck"


@pytest.mark.slow
def test_pauses_grow_and_differ(s3_root: str, proxy: Proxy, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bucket, "ATTEMPTS", 5)
    store, times = Store.open(s3_root), []

    def refuse(method: str, path: str) -> bool:
        times.append(time.monotonic())
        return True

    proxy.refuse = refuse
    with pytest.raises(ObjectStoreError):
        store.write_bytes("file", b"")
    pauses = [later - earlier for earlier, later in pairwise(times)]
    assert len(pauses) == 4
    assert len({round(pause, 2) for pause in pauses}) > 1


@pytest.mark.usefixtures("impatient")
def test_a_lasting_failure_names_the_file_and_loses_nothing(s3_root: str, proxy: Proxy) -> None:
    store = Store.open(s3_root)
    store.write_bytes("tables/file", b"old")
    proxy.refuse = lambda method, path: True
    actions = {"write_bytes": (b"new",), "read_bytes": (), "move": ("x",), "delete": ()}
    for action in (partial(getattr(store, name), "tables/file", *more) for name, more in actions.items()):
        failing = f"{s3_root}/tables/file: the object store went on failing"
        with pytest.raises(ObjectStoreError, match=failing):
            action()
    proxy.refuse = lambda method, path: False
    assert store.files() == ("tables/file",)
    assert store.read_bytes("tables/file") == b"old"


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("part", [*PARTS, "POST"])
def test_a_large_upload_that_fails_midway_leaves_no_object(s3_root: str, proxy: Proxy, part: str) -> None:
    store = Store.open(s3_root)
    proxy.refuse = lambda method, path: part in path or (method == part and "uploadId" in path)
    with pytest.raises(ObjectStoreError, match="file"):
        store.write_bytes("file", LARGE)
    proxy.refuse = lambda method, path: False
    assert not store.exists("file")
    assert store.files() == ()
    store.write_bytes("file", LARGE)
    assert store.read_bytes("file") == LARGE


def test_a_missing_bucket_is_refused_by_name(s3_root: str) -> None:
    store = Store.open("s3://no-such-bucket/root")
    missing = r"s3://no-such-bucket/root\S*: the bucket does not exist; create"
    for check in (check_usable, Results):
        with pytest.raises(ObjectStoreError, match=missing):
            check(store)


def test_missing_rights_are_refused_and_all_rights_leave_nothing(s3_root: str, proxy: Proxy) -> None:
    check_usable(Store.open(s3_root))
    assert Store.open(s3_root).files() == ()
    denied = b"<Error><Code>AccessDenied</Code><Message>Access Denied</Message></Error>"
    proxy.refusal = (403, denied)
    for right in ("GET", "PUT", "POST"):
        proxy.refuse = lambda method, path, right=right: method == right
        with pytest.raises(ObjectStoreError, match="rights to list, read, write and delete"):
            check_usable(Store.open(s3_root))


REPLACER = """
import sys
from itertools import count
from tma_ray.results import Store

store = Store.open(sys.argv[1])
for number in count():
    store.write_bytes("checkpoint", bytes([number % 256]) * 25_000_000)  # three parts of one upload
    print(number, flush=True)
"""


def kill_midway(root: str, delay: float, look: Callable[[], object]) -> int:
    """Kill the replacer `delay` seconds after it first said a number; return the last one that it said."""
    command = [sys.executable, "-c", REPLACER, root]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        said = int(process.stdout.readline())
        look()
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        return max([said, *(int(line) for line in process.stdout if line.endswith("\n"))])


@pytest.mark.slow
def test_a_large_object_whose_replacement_is_killed_keeps_its_old_content(s3_root: str) -> None:
    chance, store, cut = random.Random(1), Store.open(s3_root), 0

    def look() -> int:
        content = store.read_bytes("checkpoint")
        assert content == content[:1] * 25_000_000
        return content[0]

    for _ in range(6):
        said = kill_midway(s3_root, chance.uniform(0.0, 0.3), look)
        cut += look() == said
    assert cut > 0, "some uploads were cut off"

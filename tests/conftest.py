"""How the suite runs (see `suite`), and a real S3 server on this machine for all tests of object stores."""

from __future__ import annotations

import os
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from itertools import count

import pytest

# Tests share the cores already, and would wait for each other's threads.
os.environ.setdefault("OMP_NUM_THREADS", "1")

pytest_plugins = [f"suite.{name}" for name in ("costs", "distribution", "isolation", "kernels", "order")]

BUCKET = "bucket"

SERVER = """
import sys
from moto.server import ThreadedMotoServer

server = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
server.start()
print("http://{}:{}".format(*server.get_host_and_port()), flush=True)
sys.stdin.read()
"""
"""An S3 server on a port that the system chooses; it ends when its standard input does."""

_number = count()


@pytest.fixture(scope="session")
def s3_server() -> Iterator[str]:
    """URL of an S3 server in a process of its own, with one empty bucket; ends with the tests."""
    pytest.importorskip("moto.server", reason="pip install 'tma_ray[dev]' brings the S3 server")
    command = [sys.executable, "-c", SERVER]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, text=True, **pipes) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        url = server.stdout.readline().strip()
        assert url, "the S3 server did not start"
        urllib.request.urlopen(urllib.request.Request(f"{url}/{BUCKET}", method="PUT"))
        yield url
        server.stdin.close()


@pytest.fixture
def s3_environment(
    s3_server: str, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> str:
    """URL of the server, with all that leads to it in the environment, and no settings of the user's."""
    nowhere = str(tmp_path_factory.getbasetemp() / "no_such_file")
    for name in ("AWS_SESSION_TOKEN", "AWS_PROFILE", "AWS_ENDPOINT_URL_S3", "AWS_DEFAULT_REGION"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "a-secret/of-the/tests",
        "AWS_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": s3_server,
        "AWS_EC2_METADATA_DISABLED": "true",
        "AWS_CONFIG_FILE": nowhere,
        "AWS_SHARED_CREDENTIALS_FILE": nowhere,
    }.items():
        monkeypatch.setenv(name, value)
    return s3_server


@pytest.fixture
def s3_root(s3_environment: str) -> str:
    """URI of an empty folder of the bucket, another one for every test."""
    return f"s3://{BUCKET}/root-{next(_number)}"

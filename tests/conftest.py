"""How the suite runs (see `suite`); an S3 server of this machine and Chromium, for tests of all folders."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import count
from typing import TYPE_CHECKING

import pytest
from suite.object_server import ObjectServer

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# Tests share the cores already, and would wait for each other's threads.
os.environ.setdefault("OMP_NUM_THREADS", "1")

pytest_plugins = [f"suite.{name}" for name in ("costs", "distribution", "isolation", "kernels", "order")]

_number = count()


@pytest.fixture(scope="session")
def s3_server() -> Iterator[dict[str, str]]:
    """The variables that lead to an S3 server in a process of its own; it ends with the tests."""
    pytest.importorskip("moto.server", reason="pip install 'tma_ray[dev]' brings the S3 server")
    with ObjectServer() as server:
        yield server.environment


@pytest.fixture
def s3_environment(s3_server: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> str:
    """URL of the server, with all that leads to it in the environment, and no settings of the user's."""
    for name in ("AWS_SESSION_TOKEN", "AWS_PROFILE", "AWS_ENDPOINT_URL_S3", "AWS_DEFAULT_REGION"):
        monkeypatch.delenv(name, raising=False)
    for name, value in s3_server.items():
        monkeypatch.setenv(name, value)
    return s3_server["AWS_ENDPOINT_URL"]


@pytest.fixture
def s3_root(s3_environment: str) -> str:
    """URI of an empty folder of the bucket, another one for every test."""
    return f"s3://{ObjectServer.bucket}/root-{next(_number)}"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Headless Chromium."""
    from browsers import chromium

    with chromium() as launched:
        yield launched

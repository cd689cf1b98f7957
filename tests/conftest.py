"""Plug-ins of the suite (see `suite`), and fixtures of all folders: a local S3 server, and Chromium."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import count
from typing import TYPE_CHECKING

import pytest
from suite.object_server import ObjectServer

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# Tests run in parallel already, and more threads would slow each other down.
os.environ.setdefault("OMP_NUM_THREADS", "1")

pytest_plugins = [f"suite.{name}" for name in ("costs", "distribution", "isolation", "kernels", "order")]
_number = count()


@pytest.fixture(scope="session")
def s3_server() -> Iterator[dict[str, str]]:
    """Environment variables of an S3 server in a separate process, which ends with the tests."""
    pytest.importorskip("moto.server", reason="pip install 'tma_ray[dev]' brings the S3 server")
    with ObjectServer() as server:
        yield server.environment


@pytest.fixture
def s3_environment(s3_server: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> str:
    """URL of the S3 server, with its environment variables set and the user's removed."""
    for name in ("AWS_SESSION_TOKEN", "AWS_PROFILE", "AWS_ENDPOINT_URL_S3", "AWS_DEFAULT_REGION"):
        monkeypatch.delenv(name, raising=False)
    for name, value in s3_server.items():
        monkeypatch.setenv(name, value)
    return s3_server["AWS_ENDPOINT_URL"]


@pytest.fixture
def s3_root(s3_environment: str) -> str:
    """URI of a new empty folder of the bucket."""
    return f"s3://{ObjectServer.bucket}/root-{next(_number)}"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Headless Chromium."""
    from browsers import chromium

    with chromium() as launched:
        yield launched

"""Fixture of a proxy that disturbs requests."""

from collections.abc import Iterator

import pytest
from s3_proxy import Proxy


@pytest.fixture
def proxy(s3_environment: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Proxy]:
    """Proxy between this process and the S3 server."""
    with Proxy(s3_environment) as standing:
        monkeypatch.setenv("AWS_ENDPOINT_URL", standing.url)
        yield standing

"""Object stores meet whole runs: worlds and helpers are those of the tests of runs."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from s3_proxy import Proxy

sys.path.insert(0, str(Path(__file__).parents[1] / "runs"))


@pytest.fixture
def proxy(s3_environment: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Proxy]:
    """Stands between this process and the server."""
    with Proxy(s3_environment) as standing:
        monkeypatch.setenv("AWS_ENDPOINT_URL", standing.url)
        yield standing

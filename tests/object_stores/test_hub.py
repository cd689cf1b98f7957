"""Releases at ``hf://`` addresses, on a server of this machine that answers as Hugging Face's hub does."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.object_stores.hub import Hub, served

pytest.importorskip("huggingface_hub")

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2] / "notebooks" / "data" / "ppo-lite"
ADDRESS = "hf://datasets/me/mine-1.0"


def command(hub: Hub, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the command in a process whose library knows `hub` and no other."""
    environment = os.environ | {"HF_ENDPOINT": hub.address, "HF_TOKEN": "secret", "COLUMNS": "80"}
    words = [sys.executable, "-m", "tma_ray.cli", *map(str, arguments)]
    return subprocess.run(words, env=environment, capture_output=True, text=True, check=False)


def test_a_release_is_published_verified_and_read() -> None:
    with served() as hub:
        hub.repositories["me/mine-1.0"] = {".gitattributes": b"*.parquet filter=lfs\n"}
        published = command(hub, "release", ROOT, "mine-1.0", "--output", "hf://datasets/me")
        assert (published.returncode, published.stdout.strip()) == (0, ADDRESS), published.stderr
        whole = command(hub, "baselines", "verify", ADDRESS)
        assert whole.returncode == 0, whole.stdout + whole.stderr
        read = command(hub, "ranking", ADDRESS)
        assert (read.returncode, read.stdout) == (0, command(hub, "ranking", ROOT).stdout)
        hub.repositories["me/mine-1.0"]["README.md"] += b"another"
        changed = command(hub, "baselines", "verify", ADDRESS)
        assert changed.returncode == 1
        assert "README.md" in changed.stdout + changed.stderr


def test_a_hub_that_refuses_and_one_that_is_gone_are_told_from_an_empty_place() -> None:
    with served() as hub:
        hub.repositories["me/mine-1.0"] = {"README.md": b"a card"}
        empty = command(hub, "baselines", "verify", ADDRESS)
        private = command(hub, "baselines", "verify", "hf://datasets/me/private")
    gone = command(hub, "baselines", "verify", ADDRESS)
    assert [each.returncode for each in (empty, private, gone)] == [2, 2, 2]
    assert f"{ADDRESS} is not a baseline: baseline.json is missing" in empty.stderr
    assert "hf://datasets/me/private/baseline.json was refused: 401" in private.stderr
    assert f"{ADDRESS}/baseline.json cannot be reached" in gone.stderr
    assert "secret" not in private.stderr + gone.stderr

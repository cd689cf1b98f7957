"""The site of a version lies beside those of earlier versions, and its pages have a menu of them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from blocks import ROOT


@pytest.mark.slow
def test_versions_lie_beside_each_other(tmp_path: Path) -> None:
    checkout = tmp_path / "checkout"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(checkout)], check=True)
    author = {f"GIT_{role}_{key}": "a@b" for role in ("AUTHOR", "COMMITTER") for key in ("NAME", "EMAIL")}
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"  # mike starts mkdocs by its name
    environment = {**os.environ, **author, "PATH": path, "PYTHONPATH": str(checkout)}

    def mike(*arguments: str) -> None:
        subprocess.run(["mike", *arguments], cwd=checkout, env=environment, check=True, timeout=300)

    def published(path: str) -> str:
        command = ["git", "show", f"gh-pages:{path}"]
        return subprocess.run(command, cwd=checkout, check=True, capture_output=True, text=True).stdout

    mike("deploy", "--update-aliases", "0.1", "latest")
    mike("deploy", "--update-aliases", "0.2", "latest")
    mike("set-default", "latest")
    versions = {entry["version"]: entry["aliases"] for entry in json.loads(published("versions.json"))}
    assert versions == {"0.2": ["latest"], "0.1": []}
    for place in ("0.1", "0.2"):
        assert '"provider": "mike"' in published(f"{place}/index.html")
    assert "latest" in published("index.html")

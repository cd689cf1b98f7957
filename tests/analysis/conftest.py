"""Fixtures: a campaign of synthetic runs, and a function that runs commands."""

from pathlib import Path

import pytest
from synthetic_results import SyntheticCampaign
from views import Told

from tma_ray.cli import main


@pytest.fixture
def campaign(tmp_path: Path) -> SyntheticCampaign:
    return SyntheticCampaign(tmp_path / "root", steps=1000)


@pytest.fixture
def told(capsys: pytest.CaptureFixture[str]) -> Told:
    """Function that runs a command with an expected exit code, and returns its output."""

    def run(code: int, *words: object) -> str:
        capsys.readouterr()
        assert main([str(word) for word in words]) == code
        said = capsys.readouterr()
        return said.err if code == 2 else said.out

    return run

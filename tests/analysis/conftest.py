"""A campaign to write invented runs to."""

from __future__ import annotations

from pathlib import Path

import pytest
from synthetic_results import SyntheticCampaign


@pytest.fixture
def campaign(tmp_path: Path) -> SyntheticCampaign:
    return SyntheticCampaign(tmp_path / "root", steps=1000)

"""Names in the terminal: what a user calls a teacher is printed as it is, whatever rich makes of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from synthetic_results import SyntheticCampaign

import analysis
import tma_ray
from tma_ray.cli import main

NAMES = ("[red]x", "[/x]", ":smile:")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("names")
    campaign = SyntheticCampaign(folder, experiment="[bold]mine")
    for number, teacher in enumerate(("random", *NAMES)):
        for seed in range(2):
            values = {2_000_000: [300.0, 20.0 * seed]}
            campaign.plain_run(teacher, seed, values, run_id=f"run-{number}-{seed}")
    return folder


@pytest.mark.parametrize(("command", "options"), [("ranking", []), ("status", ["--cells"])])
def test_names_are_printed_as_they_are(
    root: Path,
    command: str,
    options: list[str],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert main([command, str(root), *options]) == 0
    printed = capsys.readouterr().out
    for name in NAMES:
        assert name in printed


def test_every_console_is_one_that_prints_names_as_they_are() -> None:
    folders = [Path(str(package.__file__)).parent for package in (analysis, tma_ray)]
    makers = [
        path.name
        for folder in folders
        for path in folder.rglob("*.py")
        if re.search(r"\bConsole\(", path.read_text(encoding="utf-8"))
    ]
    assert makers == ["terminal.py"]

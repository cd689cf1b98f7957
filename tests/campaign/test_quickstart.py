"""The stages of `tma-ray quickstart`, with a campaign that only records its call; those of 'make install'."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from tma_ray.campaign import costs, script
from tma_ray.campaign.costs import Throughput
from tma_ray.cli import main

ROOT = Path(__file__).parents[2]


@pytest.fixture
def code(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """What the campaign ends with; nothing is measured, trained or written."""
    codes = [0]
    measured = Throughput("any", 1e4, 1e4, 100)
    monkeypatch.setattr(costs, "measured_speeds", lambda kinds, *_: dict.fromkeys(kinds, measured))
    monkeypatch.setattr(script, "execute", lambda campaign, options: codes[0])
    monkeypatch.setattr(
        "analysis.pages.report.write_report", lambda root, output: Path(root) / "report" / "index.html"
    )
    return codes


def test_every_stage_is_announced_and_timed(code: list[int], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["quickstart", "--results", "out"]) == 0
    shown = capsys.readouterr().out
    assert re.findall(r"^\[(\d)/3\]", shown, re.MULTILINE) == ["1", "2", "3"]
    assert re.search(r"^\[2/3\] Training: .*core-hours, \d+ min with \d+ runs? at once", shown, re.MULTILINE)
    for stage in ("compilation", "training", "report"):
        assert re.search(rf"^  {stage}.* 0 min \d\d s$", shown, re.MULTILINE)
    assert shown.endswith("open out/report/index.html in a browser, then type\n  tma-ray ranking out\n")


def test_a_stage_that_fails_ends_it(code: list[int], capsys: pytest.CaptureFixture[str]) -> None:
    code[0] = 130
    assert main(["quickstart", "--results", "out"]) == 130
    assert "[3/3]" not in capsys.readouterr().out


def test_a_dry_run_says_what_would_be_trained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "root"
    assert main(["quickstart", "--dry-run", "--results", str(root)]) == 0
    assert "2 cells x 3 seeds = 6 runs, 4,200,000 environment steps" in capsys.readouterr().out
    assert not root.exists()


def test_make_calls_the_command() -> None:
    told = subprocess.run(["make", "-n", "quickstart"], cwd=ROOT, capture_output=True, text=True)
    assert ".venv/bin/tma-ray quickstart --results results" in told.stdout


def test_the_installation_names_its_stages() -> None:
    told = subprocess.run(
        ["make", "-n", "-W", "requirements.lock", "install"], cwd=ROOT, capture_output=True, text=True
    )
    assert told.returncode == 0
    announced = [line for line in told.stdout.splitlines() if line.startswith("echo ")]
    assert [line.split()[1].strip('"') for line in announced[:3]] == ["Creating", "Downloading", "Installing"]

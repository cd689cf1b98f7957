"""The stages of 'make quickstart' after the installation, with programs that only record their calls."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    """A folder of programs that write their arguments to `calls`; those named in FAIL fail."""
    for name in ("python", "tma-ray"):
        program = tmp_path / name
        program.write_text(
            f'#!/bin/sh\necho "{name} $*" >> {tmp_path}/calls\n[ "$FAIL" != "{name} $*" ] || exit 3\n'
        )
        program.chmod(0o755)
    return tmp_path


def quickstart(programs: Path, failing: str = "") -> subprocess.CompletedProcess[str]:
    command = ["sh", "experiments/quickstart.sh", str(programs), "out", "151"]
    environment = {"FAIL": failing, "PATH": "/usr/bin:/bin"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)


def test_every_stage_is_announced_and_timed(programs: Path) -> None:
    ended = quickstart(programs)
    assert ended.returncode == 0
    assert (programs / "calls").read_text().splitlines() == [
        "python experiments/quickstart.py --dry-run",
        "python experiments/quickstart.py --results out",
        "tma-ray report out",
    ]
    assert re.findall(r"^\[(\d)/3\]", ended.stdout, re.MULTILINE) == ["1", "2", "3"]
    assert re.search(r"installation \(once\) +2 min 31 s$", ended.stdout, re.MULTILINE)
    for stage in ("compilation", "training", "report"):
        assert re.search(rf"^  {stage}.* \d+ min \d\d s$", ended.stdout, re.MULTILINE)
    assert ended.stdout.endswith(f"source {programs}/activate && tma-ray ranking out\n")


def test_a_stage_that_fails_ends_it(programs: Path) -> None:
    failing = "python experiments/quickstart.py --results out"
    ended = quickstart(programs, failing)
    assert ended.returncode == 3
    assert (programs / "calls").read_text().splitlines()[-1] == failing
    assert "Where the time went" not in ended.stdout


def test_the_installation_names_its_stages() -> None:
    told = subprocess.run(
        ["make", "-n", "-W", "requirements.lock", "install"], cwd=ROOT, capture_output=True, text=True
    )
    assert told.returncode == 0
    announced = [line for line in told.stdout.splitlines() if line.startswith("echo ")]
    assert [line.split()[1].strip('"') for line in announced[:3]] == ["Creating", "Downloading", "Installing"]

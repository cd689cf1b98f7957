"""The user's own files in the current folder, some with names of modules that commands import."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2] / "notebooks" / "data" / "ppo-lite"

NAMES = ("analysis.py", "ray.py", "pandas.py")

SCRIPT = Path(sys.executable).with_name("tma-ray")


def ended_in(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    "start", [(sys.executable, "-m", "tma_ray.cli"), (sys.executable, "-m", "tma_ray"), (str(SCRIPT),)]
)
def test_the_users_own_files_shadow_nothing(start: tuple[str, ...], tmp_path: Path) -> None:
    for name in NAMES:
        (tmp_path / name).write_text("raise SystemExit('the file of the user was imported')\n")
    ended = ended_in(tmp_path, *start, "ranking", str(ROOT))
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "ALP-GMM" in ended.stdout


@pytest.mark.parametrize("name", ["analysis.py", "analysis/__init__.py"])
def test_what_hides_our_package_is_named(name: str, tmp_path: Path) -> None:
    place = tmp_path / name
    place.parent.mkdir(exist_ok=True)
    place.touch()
    script = "from tma_ray.cli import main\n\nraise SystemExit(main(['report', 'x']))\n"
    (tmp_path / "script.py").write_text(script)
    ended = ended_in(tmp_path, sys.executable, "script.py")
    hiding = tmp_path / Path(name).parts[0]
    assert (ended.returncode, "Traceback" in ended.stderr) == (2, False)
    assert f"{hiding} hides the package 'analysis' of tma_ray: rename it" in ended.stderr

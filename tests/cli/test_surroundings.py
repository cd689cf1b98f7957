"""Commands on unusual standard streams, and beside the user's own files in the current folder."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tma_ray.cli import main
from tma_ray.console.exit_codes import REFUSED, exit_code

RANKING = pytest.param(["ranking", "simulated-1"], marks=pytest.mark.slow, id="ranking")


@pytest.mark.parametrize("words", [["list"], ["campaign", "--help"], RANKING], ids=" ".join)
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_characters_that_a_stream_lacks_are_replaced(monkeypatch, capsys, words, encoding):
    assert main(words) == 0
    in_full = capsys.readouterr().out
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding=encoding))
    assert main(words) == 0
    assert len(written.getvalue().decode(encoding).splitlines()) == len(in_full.splitlines())
    assert sys.stdout.errors == "strict", "the stream is as it was"


def test_a_stream_replaces_no_character_that_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="latin-1"))
    assert exit_code("show", lambda: sys.stdout.write("1 ± 2 ≥ 1\n") - 10) == 0
    assert written.getvalue().decode("latin-1") == "1 ± 2 ? 1\n"


@pytest.mark.skipif(os.name == "nt", reason="a shell closes streams")
@pytest.mark.parametrize(
    ("command", "code", "shown"),
    [
        ("list teachers <&-", 0, "alp_gmm"),
        ("list teachers >&-", 0, ""),
        ("list teachers <&- >&- 2>&-", 0, ""),
        ("list nonsense 2>&-", REFUSED, ""),
        ("run --steps 50M --results {root} <&-", REFUSED, "pass --yes to start it"),
    ],
)
def test_closed_streams_lead_nowhere(tmp_path: Path, command: str, code: int, shown: str) -> None:
    script = f"'{sys.executable}' -m tma_ray {command.format(root=tmp_path / 'root')}"
    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True, timeout=120)
    assert (done.returncode, "Traceback" in done.stderr) == (code, False), done.stderr
    assert shown in done.stdout + done.stderr


@pytest.mark.skipif(os.name == "nt", reason="a shell closes streams")
def test_no_file_takes_the_descriptor_of_a_closed_stream(tmp_path: Path) -> None:
    """The file would get what a child of the command prints."""
    script = (
        "import subprocess\n"
        "from tma_ray.console.exit_codes import exit_code\n"
        "def command():\n"
        f"    with open({str(tmp_path / 'file')!r}, 'w') as file:\n"
        "        subprocess.run(['echo', 'printed'], close_fds=False, pass_fds=())\n"
        "        return int(file.fileno() < 3)\n"
        "raise SystemExit(exit_code('command', command))\n"
    )
    (tmp_path / "script.py").write_text(script)
    done = subprocess.run(["sh", "-c", f"'{sys.executable}' {tmp_path / 'script.py'} >&-"], timeout=60)
    assert done.returncode == 0
    assert (tmp_path / "file").read_text() == ""


ROOT = Path(__file__).parents[2] / "notebooks" / "data" / "ppo-lite"
NAMES = ("analysis.py", "ray.py", "pandas.py")
SCRIPT = Path(sys.executable).with_name("tma-ray")


def ended_in(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.parametrize("start", [(sys.executable, "-m", "tma_ray"), (str(SCRIPT),)])
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

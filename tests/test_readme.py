"""What the README shows works as it stands."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tma_ray.campaign import costs
from tma_ray.campaign.pace import Pace
from tma_ray.cli import main
from tma_ray.results import Results, RunStatus

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
EXAMPLES = (ROOT / "examples" / "README.md").read_text()


def blocks(language: str, text: str = README) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


def test_the_teacher_of_the_readme_trains_a_student(tmp_path: Path) -> None:
    (teacher,) = (block for block in blocks("python") if "class Frontier" in block)
    (tmp_path / "frontier.py").write_text(teacher)
    (tmp_path / "one.csv").write_text("stump_height,obstacle_spacing\n0,6\n")
    arguments = "run --teacher frontier:Frontier --student ppo --steps 2000 --test-set one.csv --results mine"
    command = [sys.executable, "-m", "tma_ray.cli", *arguments.split()]
    subprocess.run(command, cwd=tmp_path, check=True)
    (run,) = Results.open(tmp_path / "mine").runs()
    assert run.status is RunStatus.DONE
    assert "frontier:Frontier" in run.run.spec


def test_the_environment_of_the_readme_is_known_to_gymnasium() -> None:
    (example,) = (block for block in blocks("python") if "gymnasium.make" in block)
    subprocess.run([sys.executable, "-c", example + "\nassert observation.shape == (24,)"], check=True)


def commands(text: str = README) -> list[str]:
    lines = "".join(blocks("bash", text)).replace("\\\n", " ").splitlines()
    shown = [line.partition("#")[0].strip() for line in lines if line.startswith("tma-ray ")]
    return [command for command in shown if not command.startswith("tma-ray run ")]  # run for real above


@pytest.mark.parametrize("command", commands())
def test_every_command_is_understood(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Campaigns are planned but not run, simulations short; a root that does not exist is refused as such."""
    monkeypatch.chdir(tmp_path)
    (teacher,) = (block for block in blocks("python") if "class Frontier" in block)
    Path("frontier.py").write_text(teacher)
    arguments = shlex.split(command)[1:]
    if arguments[0] == "campaign":
        assert main([*arguments, "--dry-run"]) == 0
    elif arguments[0] == "render" and "--policy" not in arguments:
        assert main([*arguments, "--steps", "3"]) == 0
    elif arguments[0] == "simulate":
        assert main([*arguments, "--episodes", "20"]) == 0
    elif arguments[0] == "plan":
        monkeypatch.setattr(costs, "measure", lambda spec, settings: Pace("any", 1e4, 1e4, 100))
        assert main(arguments) == 0
    else:
        known = arguments[0] == "list" or arguments[:2] in (["baselines", "list"], ["tables", "paper-2021"])
        assert main(arguments) == (0 if known else 2)


@pytest.mark.parametrize("command", commands(EXAMPLES))
def test_the_commands_of_the_examples_are_understood(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT / "examples")
    arguments = shlex.split(command)[1:]
    if arguments[0] == "campaign":
        assert main([*arguments, "--dry-run"]) == 0
    else:
        assert main([arguments[0], str(tmp_path)]) == 2


def test_pictures_and_files_exist() -> None:
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", README):
        assert (ROOT / picture).stat().st_size > 10_000
    for text, folder in ((README, ROOT), (EXAMPLES, ROOT / "examples")):
        for target in re.findall(r"\]\(((?!http)[^)]*)\)", text):
            file, _, heading = target.partition("#")
            assert (folder / file).exists()
            headings = re.findall(r"^#+ (.*)$", (folder / file).read_text(), re.MULTILINE) if heading else []
            assert not heading or heading in [line.lower().replace(" ", "-") for line in headings]

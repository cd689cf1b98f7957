"""Types what the first pages say, as a newcomer in an empty folder, and writes the transcript as a page.

python -m venv venv && venv/bin/pip install torch dist/tma_ray-*.whl
python docs/making/make_newcomers_hour.py venv/bin empty --transcript hour.txt --output docs/newcomers_hour.md

A part that `--transcript` has already is not run again. What fails ends the hour.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import time
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).parents[2]

PARTS: Final = {
    "Look around": ("tma-ray --help", "tma-ray doctor", "tma-ray list teachers"),
    "The first campaign": (
        "tma-ray quickstart",
        "tma-ray status results",
        "tma-ray ranking results",
        "tma-ray claims results",
        "tma-ray report results --latex",
    ),
    "Beside others": (
        "tma-ray leaderboard",
        "tma-ray compare results --baseline paper-2021",
        "tma-ray tables results -o tables",
        "tma-ray figures results -o figures",
        "tma-ray baselines list",
        "tma-ray release results mine-1.0 --licence CC-BY-4.0",
        "tma-ray verify mine-1.0",
    ),
    "A teacher of one's own": (
        "wc -l frontier.py",
        "tma-ray simulate --teachers frontier:Frontier,random --challenges original --seeds 4",
        "tma-ray simulate --teachers frontier:Frontier --expert-knowledge high --seeds 10 "
        "--results simulated",
        "tma-ray compare simulated --baseline simulated-1",
        "tma-ray run --teacher frontier:Frontier --student ppo --steps 20k --results single",
        "tma-ray campaign --teachers frontier:Frontier,random --students ppo --seeds 2 --steps 40k "
        "--results mine",
        "tma-ray ranking mine",
        "tma-ray campaign --like mine-1.0 --teachers frontier:Frontier --seeds 1 --results liked --dry-run",
    ),
    "Policies": (
        "pip install --quiet 'tma_ray[render,onnx,tensorboard,wandb]'",
        "tma-ray export ppo_alp_gmm-s0 --results results -o walker --licence CC-BY-4.0",
        "tma-ray render --task 1.5,3 -o random.png",
        "tma-ray play --policy walker --task 0.5,3 -o walker.html",
    ),
    "Other tools": ("tma-ray tensorboard results events", "tma-ray wandb results --offline"),
    "An experiment of the paper": (
        "tma-ray plan full_benchmark --tier lite",
        "tma-ray experiment stump_tracks_challenges --tier smoke --results smoke",
    ),
}
"""Commands of the README and of the first pages, in their order, by what they are for."""

PROGRESS: Final = re.compile(r"^\d+/\d+ runs done, .*(left|waiting|running|steps/s)$")

SHOWN_LINES: Final = 24
"""Lines of an output that the page shows, the middle of a longer one left out."""


class Entry(NamedTuple):
    """A command, its output, and how it ended."""

    command: str
    output: str
    ending: str


def run(command: str, binaries: Path, folder: Path) -> Entry:
    """Runs a command in a shell of 80 columns.

    Raises:
        SystemExit: it fails, which is a stumble.
    """
    search = os.pathsep.join([str(binaries.absolute()), os.environ["PATH"]])
    environment = os.environ | {"PATH": search, "COLUMNS": "80"}
    environment.pop("PYTHONPATH", None)
    began = time.monotonic()
    done = subprocess.run(  # noqa: S603 - our own commands
        ["/bin/sh", "-c", command], cwd=folder, env=environment, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"$ {command}\n{done.stdout}\nended with exit code {done.returncode}")
    output = done.stdout.rstrip().replace(str(folder.absolute()), "~")
    return Entry(command, output, f"# {time.monotonic() - began:.1f} s")


def readme_teacher() -> str:
    """Returns the teacher that the README shows."""
    after = (ROOT / "README.md").read_text().partition("## Write a teacher")[2]
    return after.partition("```python\n")[2].partition("```")[0]


def shown(output: str) -> list[str]:
    """Returns the lines of an output without its progress, shortened in the middle."""
    lines = [line.rstrip() for line in output.splitlines() if not PROGRESS.match(line)]
    if len(lines) <= SHOWN_LINES:
        return lines
    half = SHOWN_LINES // 2
    return [*lines[:half], f"[… {len(lines) - 2 * half} lines]", *lines[-half:]]


def page(parts: dict[str, list[Entry]], machine: str) -> str:
    """Returns the page of a transcript."""
    text = [
        "# A newcomer's hour",
        "The wheel in a clean environment, an empty folder, a terminal of 80 columns: what the first pages "
        "say, typed in their order, with the time of each command. Lines of progress and the middle of long "
        "outputs are left out. `docs/making/make_newcomers_hour.py` types it, and stops at the first command "
        "that fails.",
        f"*Measured independently of versions: {machine}.*",
    ]
    for title, entries in parts.items():
        blocks = ["\n".join((f"$ {e.command}", *shown(e.output), e.ending)) for e in entries]
        text += [f"## {title}", "```console\n" + "\n\n".join(blocks) + "\n```"]
    return "\n\n".join(text) + "\n"


def read(file: Path) -> list[Entry]:
    """Returns the entries of a transcript."""
    blocks = file.read_text().split("\n\n$ ") if file.exists() else []
    found = []
    for block in blocks:
        command, *lines = block.strip().removeprefix("$ ").splitlines()
        found.append(Entry(command, "\n".join(lines[:-1]), lines[-1]))
    return found


def main() -> None:
    """Runs what the transcript lacks, then writes the page."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("binaries", type=Path, help="where the environment has tma-ray and pip")
    parser.add_argument("folder", type=Path, help="where to type; empty at first")
    parser.add_argument("--transcript", type=Path, required=True)
    parser.add_argument("--machine", default="2 cores with nothing else to do")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "newcomers_hour.md")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    (options.folder / "frontier.py").write_text(readme_teacher())
    known = {entry.command: entry for entry in read(options.transcript)}
    for command in (command for commands in PARTS.values() for command in commands):
        if command not in known:
            known[command] = run(command, options.binaries, options.folder)
            with options.transcript.open("a") as file:
                file.write("$ {}\n{}\n{}\n\n".format(*known[command]))
    parts = {title: [known[command] for command in commands] for title, commands in PARTS.items()}
    options.output.write_text(page(parts, options.machine))


if __name__ == "__main__":
    main()

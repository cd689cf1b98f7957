"""Record the commands of the page "Get started" with their output, run in an empty folder.

python -m venv venv && venv/bin/pip install torch dist/tma_ray-*.whl
python docs/making/make_first_hour.py venv/bin empty

Commands already in the transcript are not run again. The script ends at the first command that fails.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import time
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
TRANSCRIPT: Final = Path(__file__).with_name("first_hour.txt")

COMMANDS: Final = (
    "tma-ray doctor",
    "tma-ray quickstart",
    "tma-ray ranking results",
    "tma-ray simulate --teachers frontier:Frontier,random --challenges original --seeds 4",
)

PROGRESS: Final = re.compile(r"^\d+/\d+ runs done, .*(left|waiting|running|steps/s)$")


def run(command: str, binaries: Path, folder: Path) -> str:
    """Run a command in a shell of 80 columns; return its transcript (without progress) and duration as text.

    Raises:
        SystemExit: if the command fails.
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
    lines = [line.rstrip() for line in output.splitlines() if not PROGRESS.match(line)]
    return "\n".join((f"$ {command}", *lines, f"# {time.monotonic() - began:.1f} s"))


def readme_teacher() -> str:
    """Return the source of the teacher in the README."""
    after = (ROOT / "README.md").read_text().partition("## Write a teacher")[2]
    return after.partition("```python\n")[2].partition("```")[0]


def main() -> None:
    """Run the commands that are missing in the transcript."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("binaries", type=Path, help="where the environment has tma-ray")
    parser.add_argument("folder", type=Path, help="where to type; empty at first")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    (options.folder / "frontier.py").write_text(readme_teacher())
    entries = re.split(r"\n\n(?=\$ )", TRANSCRIPT.read_text().rstrip()) if TRANSCRIPT.exists() else []
    known = {entry.splitlines()[0].removeprefix("$ "): entry for entry in entries}
    for command in COMMANDS:
        known[command] = known.get(command) or run(command, options.binaries, options.folder)
        TRANSCRIPT.write_text("\n\n".join(known[each] for each in COMMANDS if each in known) + "\n")


if __name__ == "__main__":
    main()

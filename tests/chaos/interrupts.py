"""Ctrl-C at random times of commands, also during imports: exit code 130, and no traceback.

python tests/chaos/interrupts.py                      # 100 commands
python tests/chaos/interrupts.py --tries 1000 --seed 7

Prints the number of commands that ended as expected, and exits with 1 if any did not.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

HOUSE = Path(__file__).parents[2]
ROOT = HOUSE / "notebooks" / "data" / "ppo-lite"

COMMANDS = (
    "--help",
    "list",
    "status {root}",
    "status {root} --watch",
    "ranking {root}",
    "claims {root}",
    "verify {root}",
    "report {root} -o {new}.html",
    "figures {root} -o {new}",
    "plan parkour --tier smoke",
    "simulate --teachers random --challenges original --episodes 2000 --seeds 1 --results {new}",
    "run --student ppo --steps 20000 --results {new}",
    "render --policy random --steps 200 -o {new}.gif",
)
"""Interrupted commands: short ones, long ones, ones that write files, and an endless one."""

AS_EXPECTED = ("interrupted", "ended", "before")
"""Expected endings: exit code 130, a normal end before Ctrl-C, a kill while Python started."""

LONGEST = 8.0
"""Largest time of an interrupt after the start, s."""

PATIENCE = 60.0
"""Largest time until an interrupted command ends, s."""


@dataclass(frozen=True)
class Try:
    """Interrupted command."""

    command: str
    after: float
    code: int
    said: str

    @property
    def verdict(self) -> str:
        """One of `AS_EXPECTED`, or the problem."""
        if "Traceback" in self.said:
            ours = self.said.replace("tma_ray/__init__.py", "")  # where the signal handler is installed
            return "traceback" if "tma_ray/" in ours else "before"
        if self.code in (130, -signal.SIGINT):  # killed before or after Python's handler; shells show 130
            return "interrupted"
        return "ended" if self.code == 0 and "watch" not in self.command else f"exit code {self.code}"


def tries(count: int, chance: random.Random) -> Iterator[Try]:
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            words = chance.choice(COMMANDS).format(root=ROOT, new=f"{folder}/{number}")
            after = chance.uniform(0, LONGEST) * chance.random()  # mostly during imports
            yield interrupted(words, after, Path(folder))


def interrupted(words: str, after: float, folder: Path) -> Try:
    """Interrupt the process group of a command, as a terminal does."""
    environment = {**os.environ, "PYTHONPATH": str(HOUSE)}
    command = [sys.executable, "-m", "tma_ray", *words.split()]
    output = folder / "said.txt"
    # Between fork and exec, a child has the handlers of this process, which would ignore the signal.
    handler = signal.signal(signal.SIGINT, signal.SIG_DFL)
    with output.open("wb") as said:
        process = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=said, stderr=said, start_new_session=True
        )
        time.sleep(after)
        os.killpg(process.pid, signal.SIGINT)
        try:
            code = process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            code = process.wait()
        finally:
            signal.signal(signal.SIGINT, handler)
    return Try(words, after, code, output.read_text(errors="replace"))


def main() -> int:
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--tries", type=int, default=100, help="commands to interrupt (default: 100)")
    parser.add_argument("--seed", type=int, default=0, help="of commands and instants (default: 0)")
    options = parser.parse_args()
    found: Counter[str] = Counter()
    for each in tries(options.tries, random.Random(options.seed)):
        found[each.verdict] += 1
        if each.verdict not in AS_EXPECTED:
            what = f"{each.verdict} after {each.after:.2f} s: {each.command}"
            sys.stdout.write(f"{what}\n{each.said[-2000:]}\n")
    good = sum(found[verdict] for verdict in AS_EXPECTED)
    sys.stdout.write(f"{good} of {options.tries} ended as they should: {dict(found)}\n")
    return int(good < options.tries)


if __name__ == "__main__":
    raise SystemExit(main())

"""Code blocks and inline commands in the pages of the documentation."""

import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from write_generated import FILE, PART

ROOT = Path(__file__).parents[2]
FOLDERS = ("docs", "examples", "benchmarks", "notebooks")

FILES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.md")),
]

PAGES = tuple(path.relative_to(ROOT).as_posix() for path in sorted(FILES))
"""All pages of the repository."""

FENCE = re.compile(r"^( *)```(\w*)[^\n]*\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"`((?:tma-ray|python|pytest|make|ray|sbatch|pip) [^`]+)`")
SHOWN_FILE = re.compile(r"<!-- generated: file (\S+) -->\n+$")
IN_A_FILE = re.compile(r"[Ii]n a\s+file\s+`([\w./]+)`[^\n]*\n\s*$")


@dataclass(frozen=True)
class Block:
    """Fenced code block."""

    page: str
    line: int
    language: str
    text: str  # content, or that of the file that it shows
    file: str = ""  # name in the sentence before it

    @property
    def place(self) -> str:
        """Page and line of the block."""
        return f"{self.page}:{self.line}"


def without_generated(text: str, kept: Callable[[str], bool]) -> str:
    """Replace the generated parts of a page by empty lines, except those that `kept` accepts."""
    return PART.sub(lambda part: part[0] if kept(part["name"]) else "\n" * part[0].count("\n"), text)


def written_by_hand(page: str) -> str:
    """Return the text of a page without generated parts, except the files that it shows."""
    return without_generated((ROOT / page).read_text(), lambda name: name.startswith(FILE))


def blocks_of(page: str) -> list[Block]:
    """Return the blocks of a page that are not generated, in order."""
    text = written_by_hand(page)
    found = []
    for match in FENCE.finditer(text):
        before = text[: match.start()]
        named = IN_A_FILE.search(before)
        content, file = textwrap.dedent(match[3]), named[1] if named else ""
        if shown := SHOWN_FILE.search(before):
            file = Path(shown[1]).name
        found.append(Block(page, before.count("\n") + 1, match[2], content, file))
    return found


def inline_commands(page: str) -> list[str]:
    """Return the commands with arguments in sentences and tables of a page."""
    prose = FENCE.sub("", written_by_hand(page))
    return [re.sub(r"\s+", " ", command) for command in INLINE.findall(prose)]


def lines_of(block: Block) -> list[str]:
    """Return the command lines of a block, without comments and with continued lines joined."""
    joined = block.text.replace("\\\n", " ").splitlines()
    return [line.strip() for line in joined if line.strip() and not line.lstrip().startswith("#")]

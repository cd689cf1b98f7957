"""Renew or check the generated parts of pages, and the picture of the rooms.

    python docs/making/write_generated.py           # renew stale parts, and print their names
    python docs/making/write_generated.py --check   # print their names, and exit with 1 if there are any

A part stands between the marks ``<!-- generated: NAME -->`` and ``<!-- end of generated -->``. NAME is a key
of `tables.GENERATED`, or ``file PATH`` (from the root) for a file in a code block.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import make_rooms
import tables

ROOT = Path(__file__).parents[2]

PART = re.compile(
    r"^<!-- generated: (?P<name>.+?) -->\n(?P<text>.*?)^<!-- end of generated -->$", re.MULTILINE | re.DOTALL
)

LANGUAGES = {".py": "python", ".toml": "toml", ".txt": "console"}
"""Language of a file's code block, by suffix."""

FILE = "file "


def pages() -> list[Path]:
    """Return the pages that may have generated parts, including the README."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def text_of(name: str) -> str:
    """Return the text of a generated part between its marks.

    Raises:
        KeyError: if no generated part has that name.
    """
    if name.startswith(FILE):
        path = ROOT / name.removeprefix(FILE)
        return f"\n```{LANGUAGES[path.suffix]}\n{path.read_text(encoding='utf-8')}```\n\n"
    return f"\n{tables.GENERATED[name]()}\n\n"


def renewed(page: str) -> tuple[str, list[str]]:
    """Return the text of a page with all parts generated anew, and the names of stale parts."""
    stale = []

    def part(match: re.Match[str]) -> str:
        name, text = match["name"], text_of(match["name"])
        if text != match["text"]:
            stale.append(name)
        return f"<!-- generated: {name} -->\n{text}<!-- end of generated -->"

    return PART.sub(part, page), stale


def main() -> int:
    """Renew the pages and the picture of the rooms, or check them."""
    check, count = "--check" in sys.argv[1:], 0
    for path in pages():
        text, stale = renewed(path.read_text(encoding="utf-8"))
        count += len(stale)
        for name in stale:
            print(f"{path.relative_to(ROOT)}: {name}")
        if stale and not check:
            path.write_text(text, encoding="utf-8")
    if make_rooms.PICTURE.read_text(encoding="utf-8") != make_rooms.picture():
        count += 1
        print(make_rooms.PICTURE.relative_to(ROOT))
        if not check:
            make_rooms.PICTURE.write_text(make_rooms.picture(), encoding="utf-8")
    return int(check and count > 0)


if __name__ == "__main__":
    raise SystemExit(main())

"""Every table of measured numbers names the versions that it was measured at, and is current or says why not.

A line before the table, or at the head of its section, says it, for instance::

    *Measured at physics 3, ppo 1.*
    *Measured at physics 1, sac before 1; kept for the record: SAC makes its updates elsewhere since.*
    *Measured independently of versions: requests of a store.*
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
import tables
from blocks import ROOT, without_generated

from tma_ray.benchmark import BENCHMARK_VERSION
from tma_ray.envs import ENVIRONMENTS
from tma_ray.physics import PHYSICS_VERSION
from tma_ray.results import SCHEMA_VERSION
from tma_ray.students import STUDENTS
from tma_ray.teachers import TEACHERS

FOLDERS = (ROOT / "docs", ROOT / "benchmarks")
PAGES = sorted(str(path.relative_to(ROOT)) for folder in FOLDERS for path in folder.rglob("*.md"))

NOT_MEASURED = {
    ("docs/architecture.md", "Four walks"): "how many files a walk crosses",
    ("docs/architecture.md", "Edits for three additions"): "how many edits an addition takes",
    ("docs/benchmark.md", "Protocol"): "what the paper says, and where",
    ("docs/experiments.md", "The experiments of the paper"): "how many runs the matrices have",
    ("docs/gpu.md", "What decides the speed"): "values of settings",
    ("docs/long_runs.md", "Predictions"): "what was predicted",
    ("docs/pilot.md", "Costs"): "what was planned",
    ("docs/releasing.md", "A batch of runs"): "how many cells and seeds the stages have",
    ("docs/simulated_students.md", "The challenges"): "how they are defined",
    ("docs/students.md", "SAC"): "values of settings",
    ("docs/students.md", "Students"): "names",
}
"""Tables in which most cells have a digit, although nobody measured them, and what they hold instead."""

NUMERIC = 0.5
"""Share of cells with a digit, outside of code, from which on a table counts as one of measurements."""

MARK = re.compile(
    r"^\*Measured (?:independently of versions: (?P<free>[^*]+)|at (?P<versions>[^;*]+?)"
    r"(?:; kept for the record: (?P<reason>[^*]+))?)\.\*$"
)

DATA = re.compile(r"(?:" + "|".join(tables.DATA) + r"|sensitivity|trials)\b")
"""Names of generated tables of files of measurements."""

BEFORE = "before 1"


@dataclass(frozen=True)
class Table:
    """A table of a page: the headings around it, and what the nearest mark says."""

    page: str
    line: int
    heading: str
    mark: str | None


def current() -> dict[str, set[str]]:
    """Return the present version of all that has one; names of whole catalogues stand for all in them."""
    found = {"physics": {str(PHYSICS_VERSION)}, "schema": {str(SCHEMA_VERSION)}}
    found["benchmark"] = {str(BENCHMARK_VERSION)}
    for kind, registry in (("environments", ENVIRONMENTS), ("students", STUDENTS), ("teachers", TEACHERS)):
        for name in registry.names():
            if registry.origin(name) is None:
                version = str(registry.algorithm_version(name))
                found[name] = {version}
                found.setdefault(kind, set()).add(version)
    return found


def text_of(page: str) -> str:
    """A page without generated parts but for tables of files of measurements."""
    text = (ROOT / page).read_text()
    return without_generated(text, lambda name: bool(DATA.match(name)))


def measured_tables(page: str, text: str) -> Iterator[Table]:
    """Yield the tables of measurements of a page."""
    lines, marks, headings, code = text.splitlines(), dict[int, str](), dict[int, str](), False
    position = 0
    while position < len(lines):
        line = lines[position]
        code ^= line.lstrip().startswith("```")
        heading = re.match(r"(#+) (.*)", line)
        if heading and not code:
            level = len(heading[1])
            marks = {at: mark for at, mark in marks.items() if at < level}
            headings = {at: title for at, title in headings.items() if at < level} | {level: heading[2]}
        if line.startswith("*Measured "):
            end = next(at for at in range(position, len(lines)) if lines[at].rstrip().endswith("*"))
            marks[max(headings, default=0)] = " ".join(lines[position : end + 1])
        if line.lstrip().startswith("|") and not code:
            rows = list(_rows(lines, position))
            if _numeric(rows[2:]) >= NUMERIC:
                mark = marks[max(marks)] if marks else None
                yield Table(page, position + 1, headings[max(headings)], mark)
            position += len(rows) - 1
        position += 1


def problem(table: Table) -> str | None:
    """Return what is the matter with the mark of a table, None if nothing is."""
    where = f"{table.page}, line {table.line} ({table.heading})"
    if table.mark is None:
        return f"{where}: no line says at which versions it was measured"
    mark = MARK.match(table.mark)
    if mark is None:
        return f"{where}: {table.mark!r} is no such line"
    if mark["free"]:
        return None
    now, moved = current(), []
    for item in mark["versions"].split(", "):
        name, _, version = item.removeprefix("and ").partition(" ")
        if name not in now or not (version.isdecimal() or version == BEFORE):
            return f"{where}: {item!r} is not a name and its version; known: {', '.join(now)}"
        if now[name] != {version}:
            moved.append(f"{name} is at {', '.join(sorted(now[name]))}, it was measured at {version}")
    if moved and not mark["reason"]:
        return f"{where}: {'; '.join(moved)}: measure again, or say 'kept for the record' and why"
    return None


def _rows(lines: list[str], first: int) -> Iterator[str]:
    for line in lines[first:]:
        if not line.lstrip().startswith("|"):
            return
        yield line


def _numeric(rows: list[str]) -> float:
    columns = (re.split(r"(?<!\\)\|", row.strip().strip("|"))[1:] for row in rows)
    cells = [cell for row in columns for cell in row if cell.strip()]
    return sum(bool(re.search(r"\d", re.sub(r"`[^`]*`", "", cell))) for cell in cells) / max(1, len(cells))


@pytest.mark.parametrize("page", PAGES)
def test_measured_tables_name_their_versions(page: str) -> None:
    tables = list(measured_tables(page, text_of(page)))
    problems = [problem(table) for table in tables if (page, table.heading) not in NOT_MEASURED]
    assert not any(problems), "\n".join(filter(None, problems))


def test_exemptions_are_needed() -> None:
    found = {(page, table.heading) for page in PAGES for table in measured_tables(page, text_of(page))}
    assert set(NOT_MEASURED) <= found


@pytest.mark.parametrize(
    ("mark", "complaint"),
    [
        (f"*Measured at physics {PHYSICS_VERSION}, ppo 1.*", None),
        (f"*Measured at physics {PHYSICS_VERSION - 1}, ppo 1.*", "measure again"),
        ("*Measured at physics 1, ppo before 1; kept for the record: walkers fall as before.*", None),
        ("*Measured at teachers before 1.*", "teachers is at 1"),
        ("*Measured independently of versions: requests.*", None),
        ("*Measured at noon.*", "not a name and its version"),
        ("", "no line says"),
    ],
)
def test_a_table_whose_versions_have_moved_on_is_found(mark: str, complaint: str | None) -> None:
    text = f"# Page\n\n{mark}\n\n## Section\n\n| what | ms |\n| --- | --- |\n| step | 12 |\n"
    (table,) = measured_tables("page.md", text)
    found = problem(table)
    assert found is None if complaint is None else complaint in str(found)

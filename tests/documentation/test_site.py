"""What the site makes from the code when it is built, and that nothing of it is forgotten."""

import dataclasses
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import make_rooms
import pytest
import tables
import yaml
from blocks import PAGES, ROOT
from write_generated import FILE, PART, renewed, text_of

from tma_ray import cli
from tma_ray.embodiments import embodiment_names
from tma_ray.results import SCHEMAS, Table
from tma_ray.students import default_hyperparameters
from tma_ray.teachers import TEACHERS, make_teacher

MARK = re.compile(r"^<!-- generated: (.+?) -->$", re.MULTILINE)

SLOW = ("answer", "leaderboard", "findings", "simulated", "later teachers", "budget rule")
"""Beginnings of the names of generated parts that take seconds."""


def rows_of(text: str) -> dict[str, list[str]]:
    """Return the cells of the rows of a table by the name in the first."""
    lines = (line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| `"))
    return {cells[0].split("`")[1]: cells[1:] for cells in lines}


def test_the_front_page_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


def generated_parts() -> dict[str, str]:
    texts = [(ROOT / page).read_text() for page in PAGES]
    parts = [(part["name"], part["text"]) for text in texts for part in PART.finditer(text)]
    assert len(parts) == sum(len(MARK.findall(text)) for text in texts), "a part has no end"
    return dict(parts)


def test_pages_have_every_table_and_no_other() -> None:
    names = [name for name in generated_parts() if not name.startswith(FILE)]
    assert sorted(names) == sorted(tables.GENERATED)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * name.startswith(SLOW))
        for name in sorted(generated_parts())
    ],
)
def test_generated_parts_are_current(name: str) -> None:
    assert generated_parts()[name] == text_of(name), "'make pages' renews it"


def test_a_stale_part_is_found_and_renewed() -> None:
    page = "# Page\n\n<!-- generated: test sets -->\nold\n<!-- end of generated -->\n\nText.\n"
    text, stale = renewed(page)
    assert stale == ["test sets"]
    assert f"-->\n\n{tables.test_sets()}\n\n<!--" in text
    assert text.endswith("<!-- end of generated -->\n\nText.\n")
    assert renewed(text) == (text, [])


@pytest.mark.parametrize("name", TEACHERS.names())
def test_the_table_of_a_teacher_has_its_defaults_and_says_what_they_are(name: str) -> None:
    rows = rows_of(tables.teacher(name))
    teacher = make_teacher(name)
    names = [field.name for field in dataclasses.fields(teacher) if field.init]
    shown = {key: cells[0].replace(",", "").strip('"') for key, cells in rows.items()}
    assert shown == {name: str(getattr(teacher, name)) for name in names}
    assert all(len(meaning) > 10 for _, meaning in rows.values())


@pytest.mark.parametrize("name", ["untrained", "budget rule"])
def test_a_table_of_releases_has_each_teacher_once(name: str) -> None:
    """Two rows alike are of different settings, of which no reader can tell which is which."""
    lines = tables.GENERATED[name]().splitlines()
    teachers = [line.split(" | ")[0] for line in lines]
    assert len(teachers) > 4
    assert len(set(teachers)) == len(teachers)


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_the_table_of_a_student_has_its_hyperparameters(name: str) -> None:
    assert set(rows_of(tables.GENERATED[f"student {name}"]())) == set(default_hyperparameters(name))


@pytest.mark.parametrize("table", Table)
def test_every_column_is_listed_with_its_unit(table: Table) -> None:
    rows = rows_of(tables.columns(table))
    assert list(rows) == SCHEMAS[table].names
    for field in SCHEMAS[table]:
        unit = (field.metadata or {}).get(b"unit", tables.NONE.encode()).decode()
        assert rows[field.name][-1] == unit


def test_the_help_is_as_printed(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    helps = dict(tables.helps())
    assert {"tma-ray", "tma-ray run", "tma-ray baselines verify"} < set(helps)
    monkeypatch.setenv("COLUMNS", "80")
    for command, text in helps.items():
        assert cli.main([*command.split()[1:], "--help"]) == 0
        shown = capsys.readouterr().out.rstrip().splitlines()
        assert list(map(str.rstrip, shown)) == text.splitlines()


def test_every_body_is_listed() -> None:
    assert set(rows_of(tables.embodiments())) == set(embodiment_names())


def own_teachers() -> list[type]:
    """Those of the package: other tests and pages may have registered more."""
    kinds = [TEACHERS.get(name) for name in TEACHERS.names()]
    return [kind for kind in kinds if kind.__module__.startswith("tma_ray.")]


def test_a_class_says_what_each_of_its_fields_is() -> None:
    for kind in own_teachers():
        own = {field.name for field in dataclasses.fields(kind) if field.init}
        assert own <= set(tables.meanings(kind))


def test_every_page_is_in_the_navigation() -> None:
    text = (ROOT / "mkdocs.yml").read_text()
    listed = set(re.findall(r"[\w/]+\.md", str(yaml.safe_load(text)["nav"])))
    pages = {page.removeprefix("docs/") for page in PAGES if page.startswith("docs/")}
    assert pages <= listed
    assert not re.search(r"https?://", text), "the site asks nobody for anything"


def test_the_picture_of_the_rooms_is_current_and_has_every_package_once() -> None:
    assert make_rooms.PICTURE.read_text() == make_rooms.picture()
    drawn = [room for floor in make_rooms.floors() for room in floor]
    packages = {f"tma_ray.{path.parent.name}" for path in (ROOT / "tma_ray").glob("*/__init__.py")}
    assert sorted(drawn) == sorted({*packages, "analysis", "tma_ray.conformance"})


def test_every_public_package_is_in_the_reference() -> None:
    texts = [path.read_text() for path in (ROOT / "docs/api").glob("*.md")]
    shown = {name for text in texts for name in re.findall(r"::: (\S+)", text)}
    packages = {f"tma_ray.{path.parent.name}" for path in (ROOT / "tma_ray").glob("*/__init__.py")}
    hidden = {f"tma_ray.{room}" for room in ("cli", "components", "console", "physics", "support")}
    assert packages - hidden <= shown
    assert {"analysis", "analysis.figures", "analysis.baselines"} <= shown
    assert {kind.__module__ for kind in own_teachers()} <= shown
    for name in shown:
        path = ROOT / Path(*name.split("."))
        assert path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


@pytest.mark.slow
def test_versions_lie_beside_each_other(tmp_path: Path) -> None:
    checkout = tmp_path / "checkout"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(checkout)], check=True)
    author = {f"GIT_{role}_{key}": "a@b" for role in ("AUTHOR", "COMMITTER") for key in ("NAME", "EMAIL")}
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"  # mike starts mkdocs by its name
    environment = {**os.environ, **author, "PATH": path, "PYTHONPATH": str(checkout)}

    def mike(*arguments: str) -> None:
        subprocess.run(["mike", *arguments], cwd=checkout, env=environment, check=True, timeout=300)

    def published(path: str) -> str:
        command = ["git", "show", f"gh-pages:{path}"]
        return subprocess.run(command, cwd=checkout, check=True, capture_output=True, text=True).stdout

    mike("deploy", "--update-aliases", "0.1", "latest")
    mike("deploy", "--update-aliases", "0.2", "latest")
    mike("set-default", "latest")
    versions = {entry["version"]: entry["aliases"] for entry in json.loads(published("versions.json"))}
    assert versions == {"0.2": ["latest"], "0.1": []}
    for place in ("0.1", "0.2"):
        assert '"provider": "mike"' in published(f"{place}/index.html")
    assert "latest" in published("index.html")

"""Examples in docstrings are run: sessions, names with settings, and command lines."""

import ast
import doctest
import importlib
import re
from pathlib import Path
from typing import Any

import pytest

from tma_ray import cli
from tma_ray.benchmark import load_test_set, shipped_test_sets
from tma_ray.console import command_line
from tma_ray.embodiments import embodiment_names, load_embodiment
from tma_ray.envs import ENVIRONMENTS
from tma_ray.runs import Cell, Schedule, effective_spec
from tma_ray.students import STUDENTS, canonical_student
from tma_ray.support.component_names import base_name, split_name
from tma_ray.teachers import TEACHERS, make_teacher

ROOT = Path(__file__).parents[2]
FILES = sorted(path for package in ("analysis", "tma_ray") for path in (ROOT / package).rglob("*.py"))
NAME = re.compile(r"[`\"']((?:[A-Za-z_]+:)+[a-z_]+=[^`\"',\s]*)[`\"']")
COMMAND = re.compile(r"``tma-ray ([^`]+)``|'tma-ray ([^'{]+)'|^\s*tma-ray (.+)$", re.MULTILINE)

NOBODYS = ("name", "module:Name", "my_teacher")
"""Names that examples of the grammar give to somebody's own."""


def found(pattern: re.Pattern[str]) -> list[tuple[str, Any]]:
    """Return what `pattern` finds in docstrings, each with its file; files without any are not parsed."""
    everything = set()
    for path in FILES:
        source = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(source)) if pattern.search(source) else ():
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                file = path.relative_to(ROOT).as_posix()
                everything |= {(file, each) for each in pattern.findall(str(node.value.value))}
    return sorted(everything)


NAMES = found(NAME)
COMMANDS = [(file, "".join(groups)) for file, groups in found(COMMAND)]


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=[pytest.mark.slow] if "envs" in path.parts else [])  # kernels are compiled
        for path in FILES
        if ">>> " in path.read_text(encoding="utf-8")
    ],
)
def test_sessions_give_what_they_show(path: Path) -> None:
    parts = path.relative_to(ROOT).with_suffix("").parts
    module = importlib.import_module(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
    tried = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert tried.failed == 0
    assert tried.attempted > 0


@pytest.mark.parametrize(("file", "name"), NAMES)
def test_names_with_settings_are_taken(file: str, name: str) -> None:
    base = base_name(name)
    if base in NOBODYS:
        assert split_name(name)[1]
    elif base in TEACHERS.names():
        make_teacher(name)
    elif base in embodiment_names():
        load_embodiment(name)
    elif base in shipped_test_sets() and "every" in split_name(name)[1]:
        load_test_set(name)
    elif base in ENVIRONMENTS.names():
        effective_spec(Cell(environment=name, embodiment="climbing_chimpanzee"), 0, Schedule())
    elif base in STUDENTS.names():
        canonical_student(name)
    else:
        effective_spec(Cell(challenge=name), 0, Schedule())


@pytest.mark.parametrize(("file", "command"), COMMANDS)
def test_commands_and_their_options_exist(file: str, command: str) -> None:
    known = {" ".join(("tma-ray", *words)): app for words, app in command_line.commands(cli.app())}
    words = command.split()
    verbs = [" ".join(("tma-ray", *words[:end])) for end in (2, 1)]
    verb = next(each for each in verbs if each in known)
    given = {word.partition("=")[0] for word in words if word.startswith("--")}
    assert given <= {name for each in command_line.arguments(known[verb]) for name in each.names}


def test_there_are_examples_of_each_kind() -> None:
    assert len(NAMES) > 10
    assert len(COMMANDS) > 3

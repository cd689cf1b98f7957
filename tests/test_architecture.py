"""The structure of the house: no import circles, no shadowed modules, readable modules and functions."""

import ast
import re
from collections import Counter
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

HOUSE = Path(__file__).parent.parent
PACKAGES = ("tma_ray", "analysis")

MOST_LINES, MOST_FUNCTION_LINES = 700, 80
"""Lines of a module, which is what one reads in one sitting, and lines of a function."""

EMPTY = frozenset(
    "at each found given here known look looks mine own place places said theirs there told wanted".split()  # noqa: SIM905 - a list takes a screen
)
"""Names of variables that hide what they hold."""

MOST_EMPTY, MOST_IMPORTS = 250, 0.115
"""Assignments to these names in all modules, and share of import lines among those with text."""

QUESTIONS = ("How", "What", "When", "Where", "Whether", "Who", "Whose", "Why")
"""First words of a docstring that asks instead of saying what a thing is or does."""


@cache
def _modules() -> dict[str, Path]:
    """Return the files of all modules by their names."""
    files = (path for package in PACKAGES for path in sorted((HOUSE / package).rglob("*.py")))
    return {_name(path): path for path in files}


def _name(path: Path) -> str:
    parts = path.relative_to(HOUSE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _imports(name: str, modules: dict[str, Path]) -> set[str]:
    """Return the modules that the text of a module imports, anywhere in it.

    ``from package import module`` imports the package as well, since its own text runs first.
    """
    imported: set[str] = set()
    for node in ast.walk(_tree(modules[name])):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: a relative import"
            assert node.module is not None
            found = {f"{node.module}.{alias.name}" for alias in node.names} & modules.keys()
            imported |= {node.module, *found}
    return (imported & modules.keys()) - {name}


def test_no_modules_import_each_other() -> None:
    modules = _modules()
    graph = {name: _imports(name, modules) for name in modules}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


def test_no_module_is_hidden_by_what_its_package_exports() -> None:
    modules = _modules()
    hidden = set()
    for name, path in modules.items():
        if path.name != "__init__.py":
            continue
        for node in _tree(path).body:
            if isinstance(node, ast.ImportFrom):
                names = {f"{name}.{alias.asname or alias.name}" for alias in node.names}
                hidden |= {each for each in names & modules.keys() if node.module != name}
    assert not hidden


def test_modules_and_functions_are_short() -> None:
    long = {
        f"{name}:{node.lineno}"
        for name, path in _modules().items()
        for node in ast.walk(_tree(path))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and node.end_lineno - node.lineno >= MOST_FUNCTION_LINES
    }
    assert not long
    lines = {name: len(path.read_text(encoding="utf-8").splitlines()) for name, path in _modules().items()}
    assert not {name for name, count in lines.items() if count > MOST_LINES}


def test_one_module_uses_the_private_api_of_ray() -> None:
    private = re.compile(r"\bray\._(private|raylet)\b")
    users = [name for name, path in _modules().items() if private.search(path.read_text(encoding="utf-8"))]
    assert users == ["tma_ray.campaign.cluster.ray_private"]


def test_the_ground_floor_holds_rooms() -> None:
    loose = {path.name for path in (HOUSE / "tma_ray").glob("*.py")}
    assert loose == {"__init__.py", "__main__.py", "conformance.py"}


def test_public_classes_have_one_meaning_each_and_constants_one_definition() -> None:
    classes, constants = Counter[str](), Counter[str]()
    for path in _modules().values():
        body = _tree(path).body
        classes.update({node.name for node in body if isinstance(node, ast.ClassDef)})
        targets = [target for node in body if isinstance(node, ast.Assign) for target in node.targets]
        targets += [node.target for node in body if isinstance(node, ast.AnnAssign)]
        constants.update({each.id for each in targets if isinstance(each, ast.Name) and each.id.isupper()})
    assert not {name for name, count in classes.items() if count > 1 and name[0] != "_"}
    assert not {name for name, count in constants.items() if count > 2 and name[0] != "_"}


def test_variables_are_named_by_what_they_hold() -> None:
    stored = [
        node.id
        for path in _modules().values()
        for node in ast.walk(_tree(path))
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id.strip("_") in EMPTY
    ]
    assert len(stored) < MOST_EMPTY, Counter(stored)


def test_import_lines_are_few() -> None:
    lines = imports = 0
    for path in _modules().values():
        tree = _tree(path)
        text = path.read_text(encoding="utf-8").splitlines()
        lines += sum(bool(line.strip()) and not line.strip().startswith("#") for line in text)
        imports += sum(
            node.end_lineno - node.lineno + 1
            for node in tree.body
            if isinstance(node, ast.Import | ast.ImportFrom)
        )
    assert imports <= MOST_IMPORTS * lines


def test_docstrings_of_modules_say_what_they_are() -> None:
    docstrings = {name: ast.get_docstring(_tree(path)) or "" for name, path in _modules().items()}
    assert not {name for name, docstring in docstrings.items() if not docstring}
    assert not {name for name, docstring in docstrings.items() if docstring.split()[0] in QUESTIONS}


def test_texts_say_that_a_thing_is_not_another() -> None:
    """As in "expected a level" or "is not a folder": messages name what was expected and what to do."""
    texts = {
        (name, node.value)
        for name, path in _modules().items()
        if re.search(r"\b(is|are)\s+no\b", path.read_text(encoding="utf-8"))
        for node in ast.walk(_tree(path))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    assert not {place for place in texts if re.search(r"(?<!there )\b(is|are) no\b", place[1])}


def test_the_page_on_architecture_names_every_room_and_only_files_that_exist() -> None:
    page = (HOUSE / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:tma_ray|analysis)/[\w/.]*)`", page))
    assert not {place for place in named if not (HOUSE / place).exists()}
    rooms = {path.parent.relative_to(HOUSE).as_posix() for path in _modules().values()}
    told = ("tma_ray/envs/", "tma_ray/students/")  # by the row of their floor
    unnamed = {room for room in rooms if room not in PACKAGES and f"`{room}/`" not in page}
    assert not {room for room in unnamed if not room.startswith(told)}


def test_the_page_on_architecture_lists_every_room_once() -> None:
    page = (HOUSE / "docs" / "architecture.md").read_text(encoding="utf-8")
    rooms = [room for row in re.findall(r"^\| (`.*?) \|", page, re.M) for room in re.findall(r"`(.*?)`", row)]
    assert rooms
    assert not {each for each, count in Counter(rooms).items() if count > 1}


def test_the_files_of_each_walk_are_counted() -> None:
    page = (HOUSE / "docs" / "architecture.md").read_text(encoding="utf-8")
    table, *walks = page.partition("## Four walks")[2].partition("\n## ")[0].split("\n### ")
    counted = {
        walk.splitlines()[0].lower(): len(set(re.findall(r"`((?:tma_ray|analysis)/[\w/]+\.py)`", walk)))
        for walk in walks
    }
    rows = re.findall(r"^\| (\w.*) \| (\d+) \|$", table.lower(), re.MULTILINE)
    assert counted == {name: int(count) for name, count in rows}

"""References in docstrings, in single backticks: `name`, `module.name`, `Class.member`."""

import ast
import builtins
import re
from collections import defaultdict
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = [path for package in ("tma_ray", "analysis") for path in sorted((ROOT / package).rglob("*.py"))]
REFERENCE = re.compile(r"(?<!`)`([A-Za-z_][\w.]*)(?:\(\))?`(?!`)")


def docstrings(tree: ast.Module) -> Iterator[str]:
    """Yield the texts that stand alone: docstrings of modules, classes, functions, fields and constants."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                yield text


def bound(node: ast.AST) -> Iterator[str]:
    """Yield the names that a node gives to something."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield node.name
    elif isinstance(node, ast.arg | ast.keyword):
        yield node.arg or ""
    elif isinstance(node, ast.alias):
        yield (node.asname or node.name).split(".")[0]
    elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
        yield node.id if isinstance(node, ast.Name) else node.attr


PARTS = {path: ".".join(path.relative_to(ROOT).with_suffix("").parts) for path in SOURCES}
TREES = {name.removesuffix(".__init__"): ast.parse(path.read_text()) for path, name in PARTS.items()}
NAMES = {name for tree in TREES.values() for node in ast.walk(tree) for name in bound(node)}
NAMES |= {part for module in TREES for part in module.split(".")} | {*dir(builtins)}

VARIABLES = {
    name
    for tree in TREES.values()
    for node in ast.walk(tree)
    if isinstance(node, ast.arg | ast.Attribute) or (isinstance(node, ast.AnnAssign) and node.simple)
    for name in bound(node.target if isinstance(node, ast.AnnAssign) else node)
}
"""Parameters, attributes and fields."""

CLASSES = [node for tree in TREES.values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
METHODS = {node.name for each in CLASSES for node in each.body if isinstance(node, ast.FunctionDef)}

SCOPES: dict[str, set[str]] = defaultdict(set)
"""Names in a module or class, at any depth, since methods set attributes; a class has those of its bases."""
for _module, _tree in TREES.items():
    _package, _, _name = _module.rpartition(".")
    SCOPES[_name] |= {name for node in ast.walk(_tree) for name in bound(node)}
    SCOPES[_package.rpartition(".")[2]].add(_name)
for _class in CLASSES:
    SCOPES[_class.name] |= {name for node in ast.walk(_class) for name in bound(node)}
for _class in CLASSES * 3:  # bases of bases
    for _base in _class.bases:
        SCOPES[_class.name] |= SCOPES.get(getattr(_base, "id", ""), set())


def leads_somewhere(reference: str) -> bool:
    *above, owner, name = ("", "", *reference.split("."))
    if not owner:
        return name in NAMES
    has = name in SCOPES[owner] if owner in SCOPES else owner in VARIABLES and name in VARIABLES | METHODS
    return (has and NAMES.issuperset(filter(None, above))) or _is_library(reference.partition(".")[0])


def _is_library(name: str) -> bool:
    return name not in ("tma_ray", "analysis") and find_spec(name) is not None


def test_every_reference_in_a_docstring_leads_somewhere() -> None:
    lost = {
        f"{module}: {reference}"
        for module, tree in TREES.items()
        for text in docstrings(tree)
        for reference in REFERENCE.findall(text)
        if not leads_somewhere(reference)
    }
    assert not lost, "\n".join(sorted(lost))

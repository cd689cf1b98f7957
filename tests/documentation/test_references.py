"""References in docstrings, in single backticks: `name`, `module.name`, `Class.member`."""

import ast
import builtins
import re
from collections import defaultdict
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import chain
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


class Sources:
    """Trees of all sources, and the names that they bind.

    Attributes:
        trees: tree of each module by its name.
        names: names bound anywhere, with the parts of the modules' names and the built-in ones.
        variables: parameters, attributes and fields.
        methods: names of methods.
        scopes: names in a module or class, at any depth, since methods set attributes; a class has those of
            its bases.
    """

    def __init__(self) -> None:
        parts = {path: ".".join(path.relative_to(ROOT).with_suffix("").parts) for path in SOURCES}
        self.trees = {
            name.removesuffix(".__init__"): ast.parse(path.read_text()) for path, name in parts.items()
        }
        nodes = {module: list(ast.walk(tree)) for module, tree in self.trees.items()}
        every = list(chain.from_iterable(nodes.values()))
        self.names = {name for node in every for name in bound(node)}
        self.names |= {part for module in self.trees for part in module.split(".")} | {*dir(builtins)}
        self.variables = {
            name
            for node in every
            if isinstance(node, ast.arg | ast.Attribute) or (isinstance(node, ast.AnnAssign) and node.simple)
            for name in bound(node.target if isinstance(node, ast.AnnAssign) else node)
        }
        classes = [node for node in every if isinstance(node, ast.ClassDef)]
        self.methods = {
            node.name for each in classes for node in each.body if isinstance(node, ast.FunctionDef)
        }
        self.scopes: dict[str, set[str]] = defaultdict(set)
        for module in self.trees:
            package, _, name = module.rpartition(".")
            self.scopes[name] |= {each for node in nodes[module] for each in bound(node)}
            self.scopes[package.rpartition(".")[2]].add(name)
        for each in classes:
            self.scopes[each.name] |= {name for node in ast.walk(each) for name in bound(node)}
        for each in classes * 3:  # bases of bases
            for base in each.bases:
                self.scopes[each.name] |= self.scopes.get(getattr(base, "id", ""), set())

    def have(self, reference: str) -> bool:
        """Return True if a reference leads to something."""
        *above, owner, name = ("", "", *reference.split("."))
        if not owner:
            return name in self.names
        if owner in self.scopes:
            found = name in self.scopes[owner]
        else:
            found = owner in self.variables and name in self.variables | self.methods
        return (found and self.names.issuperset(filter(None, above))) or _is_library(
            reference.partition(".")[0]
        )


def _is_library(name: str) -> bool:
    return name not in ("tma_ray", "analysis") and find_spec(name) is not None


def test_every_reference_in_a_docstring_leads_somewhere() -> None:
    sources = Sources()
    lost = {
        f"{module}: {reference}"
        for module, tree in sources.trees.items()
        for text in docstrings(tree)
        for reference in REFERENCE.findall(text)
        if not sources.have(reference)
    }
    assert not lost, "\n".join(sorted(lost))

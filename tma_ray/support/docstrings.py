"""Docstrings read from source files without importing them."""

import ast
import importlib.util
from functools import cache
from pathlib import Path


def docstring_of(module: str, name: str) -> str | None:
    """Return the docstring of a class or function of a module, None if it is not defined there."""
    return _docstrings(module).get(name)


@cache
def _docstrings(module: str) -> dict[str, str]:
    try:
        spec = importlib.util.find_spec(module)
    except ImportError:
        return {}
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return {}
    nodes = reversed(ast.parse(Path(spec.origin).read_bytes()).body)  # the first definition counts
    definitions = (node for node in nodes if isinstance(node, (ast.ClassDef, ast.FunctionDef)))
    return {node.name: ast.get_docstring(node) or "" for node in definitions}

"""Docstrings of classes and functions, read from the source without importing it."""

from __future__ import annotations

import ast
import importlib.util
from functools import cache
from pathlib import Path


def docstring_of(module: str, name: str) -> str | None:
    """Return the docstring of the class or function `name` of a module; None if it does not define that."""
    for node in _definitions(module):
        if node.name == name:
            return ast.get_docstring(node) or ""
    return None


@cache
def _definitions(module: str) -> tuple[ast.ClassDef | ast.FunctionDef, ...]:
    try:
        spec = importlib.util.find_spec(module)
    except ImportError:
        return ()
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return ()
    tree = ast.parse(Path(spec.origin).read_bytes())
    return tuple(node for node in tree.body if isinstance(node, (ast.ClassDef, ast.FunctionDef)))

"""Lazy import of a package's public names, and lookup of docstrings without importing."""

import ast
import importlib.util
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


def attach(package: str, source: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` for lazy import of a package's ``if TYPE_CHECKING:`` names.

    Args:
        package: ``__name__`` of the package.
        source: ``__file__`` of the package.
    """
    blocks = [node for node in ast.parse(Path(source).read_bytes()).body if isinstance(node, ast.If)]
    imports = [node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom)]
    modules = {alias.name: str(node.module) for node in imports for alias in node.names}

    def get(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = modules[name]
        if module == package or not hasattr(import_module(module), name):
            value: Any = import_module(f"{module}.{name}")
        else:
            value = getattr(import_module(module), name)
        setattr(sys.modules[package], name, value)
        return value

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[package]), *modules})

    return get, listed


def docstring_of(module: str, name: str) -> str | None:
    """Return the docstring of a class or function in a module, or None if it is not defined there."""
    return _docstrings(module).get(name)


@cache
def _docstrings(module: str) -> dict[str, str]:
    try:
        spec = importlib.util.find_spec(module)
    except ImportError:
        return {}
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return {}
    nodes = reversed(ast.parse(Path(spec.origin).read_bytes()).body)  # a name's first definition counts
    definitions = (node for node in nodes if isinstance(node, (ast.ClassDef, ast.FunctionDef)))
    return {node.name: ast.get_docstring(node) or "" for node in definitions}

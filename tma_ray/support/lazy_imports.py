"""Packages whose parts are imported when they are first asked for: a name alone needs none of them."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def attach(package: str, source: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the functions `__getattr__` and `__dir__` of a package.

    They know what the package imports under ``if TYPE_CHECKING:``, objects or whole modules.

    Args:
        package: its ``__name__``.
        source: its ``__file__``.
    """
    blocks = [node for node in ast.parse(Path(source).read_bytes()).body if isinstance(node, ast.If)]
    imports = [node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom)]
    modules = {each.name: str(node.module) for node in imports for each in node.names}

    def get(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = modules[name]
        if module == package or not hasattr(import_module(module), name):
            found: Any = import_module(f"{module}.{name}")
        else:
            found = getattr(import_module(module), name)
        setattr(sys.modules[package], name, found)
        return found

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[package]), *modules})

    return get, listed

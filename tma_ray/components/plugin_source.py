"""Source files of plug-ins and of the user's modules that they import, and their common hash."""

import ast
import hashlib
import importlib.util
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from tma_ray.support.decoding import read_file

OURS = "tma_ray"  # this distribution, which every machine of a campaign has
PACKAGES = frozenset({OURS, "analysis"})  # top-level packages of this distribution

MAIN_GUARDS = ("__name__ == '__main__'", "'__main__' == __name__")
"""Conditions of blocks that run only in scripts, as written by `ast.unparse`."""

OUR_FOLDER = Path(__file__).resolve().parents[2]
"""Folder of `PACKAGES`. Packages of the same names elsewhere belong to the user."""

INSTALLED = frozenset({"site-packages", "dist-packages"})  # names of folders that hold installed packages


@dataclass(frozen=True)
class PluginSource:
    """Source code of a plug-in at its first lookup.

    It contains the module, its parent packages and, recursively, the modules they import anywhere, except
    installed ones, Python's and `PACKAGES`. Code under ``if __name__ == "__main__":`` is excluded, so that a
    script may hold both a teacher and its campaign.

    Attributes:
        module: importable name of the module.
        files: content by path below the import root.
        installed: True for an installed package, which every machine needs to install.
    """

    module: str
    files: Mapping[str, bytes]
    installed: bool

    @cached_property
    def digest(self) -> str:
        """Hash of all paths and of the code that runs on import."""
        content = hashlib.sha256()
        for path in sorted(self.files):
            code = self.files[path]
            code = _imported_part(code) if path.endswith(".py") else code
            content.update(f"{path}\0{len(code)}\0".encode() + code)
        return content.hexdigest()[:16]

    @classmethod
    def of(cls, module: str, data_files: Iterable[str] = ()) -> "PluginSource":
        """Return the source of a module, with the files in its folder that match patterns in `data_files`.

        Raises:
            ValueError: if the module has no file, or a pattern matches none.
        """
        name = importable_name(module)
        top = name.partition(".")[0]
        collector = _Collector(top)
        if module == "__main__" and sys.modules[module].__spec__ is None:
            collector.roots[top] = [Path(str(sys.modules[module].__file__)).absolute().parent]
        collector.add(name)
        if not collector.files:
            raise ValueError(f"module {name!r} has no Python file by which to tell its versions apart")
        root, file = collector.locate(name)
        for pattern in data_files:
            paths = [path for path in sorted(file.parent.glob(pattern)) if path.is_file()]
            if not paths:
                raise ValueError(f"data_files: no file {pattern!r} in {file.parent}")
            collector.files |= {path.relative_to(root).as_posix(): read_file(path) for path in paths}
        return cls(name, collector.files, _is_installed(root))


def importable_name(module: str) -> str:
    """Return the name by which other processes can import `module`.

    Raises:
        ValueError: if it is an interactive session, or its file name is not a valid module name.
    """
    if module != "__main__":
        return module
    main = sys.modules["__main__"]
    file = getattr(main, "__file__", None)
    if file is None:
        raise ValueError("it is defined in an interactive session; put it into a file that can be imported")
    name = main.__spec__.name if main.__spec__ else Path(file).stem  # python -m name or python name.py
    if not all(part.isidentifier() for part in name.split(".")) or name == "__main__":
        raise ValueError(f"it is defined in {file}, which no import can name; rename the file")
    return name


class _Collector:
    """Collector of the user's files that a module imports, without executing them.

    Args:
        top: top-level package or module to collect even if it is installed.

    Attributes:
        roots: import roots of top-level names, empty for names that are not collected.
        files: collected files.
    """

    def __init__(self, top: str) -> None:
        self._top = top
        self.roots: dict[str, list[Path]] = {}
        self.files: dict[str, bytes] = {}

    def locate(self, module: str) -> tuple[Path, Path]:
        """Return the import root and the file of `module`, or raise a FileNotFoundError."""
        for root in self._roots_of(module.partition(".")[0]):
            path = root.joinpath(*module.split("."))
            for file in (path / "__init__.py", path.with_name(f"{path.name}.py")):
                if file.is_file():
                    return root, file
        raise FileNotFoundError(module)

    def add(self, module: str) -> None:
        """Add the files of `module` and its parent packages and, recursively, those of their imports."""
        parts = module.split(".")
        for length in range(1, len(parts) + 1):
            name = ".".join(parts[:length])
            try:
                root, file = self.locate(name)
            except FileNotFoundError:  # an installed module, a namespace, or an attribute
                continue
            path = file.relative_to(root).as_posix()
            if path not in self.files:
                self.files[path] = read_file(file)
                package = name if file.name == "__init__.py" else name.rpartition(".")[0]
                for imported in _imports(self.files[path], package):
                    self.add(imported)

    def _roots_of(self, top: str) -> list[Path]:
        """Return the collected import roots of a top-level name (several for a namespace package)."""
        if top not in self.roots:
            spec = None
            with suppress(ImportError, ValueError):  # there is no such module, or it has no spec
                spec = importlib.util.find_spec(top)
            paths = list(spec.submodule_search_locations or ()) if spec else []
            if spec and not paths and spec.has_location and spec.origin:
                paths = [spec.origin]
            folders = [Path(path).absolute().parent for path in paths]
            if top in PACKAGES:
                folders = [folder for folder in folders if folder.resolve() != OUR_FOLDER]
            self.roots[top] = [folder for folder in folders if top == self._top or not _is_installed(folder)]
        return self.roots[top]


def _is_installed(folder: Path) -> bool:
    standard_library = Path(sysconfig.get_path("stdlib")).resolve()
    return bool(INSTALLED & set(folder.parts)) or folder.resolve().is_relative_to(standard_library)


def _imports(code: bytes, package: str) -> Iterator[str]:
    """Yield the dotted names that the `code` of a module in `package` imports."""
    for node in ast.walk(ast.parse(_imported_part(code))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            # in a relative import, one dot means `package` itself, and each further dot the next parent
            above = package.split(".")[: 1 - node.level or None] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _imported_part(code: bytes) -> bytes:
    """Return `code` without the blocks under ``if __name__ == "__main__":``."""
    lines = code.splitlines(keepends=True)
    end = len(lines)
    for node in reversed(ast.parse(code).body):
        start = min([node.lineno, *(part.lineno for part in getattr(node, "decorator_list", ()))]) - 1
        if isinstance(node, ast.If) and not node.orelse and ast.unparse(node.test) in MAIN_GUARDS:
            del lines[start:end]  # including comments after the block
        end = start
    return b"".join(lines)

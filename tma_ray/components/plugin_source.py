"""The source of a plug-in: its module and what that imports of the user's own, as files with one hash."""

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

OURS = "tma_ray"
"""What every machine of a campaign has installed, and whose version is part of every run already."""

MAIN_GUARDS = ("__name__ == '__main__'", "'__main__' == __name__")
"""Conditions of what runs only when a file is started as a script, as `ast.unparse` writes them."""

PACKAGES = frozenset({OURS, "analysis"})
"""Top-level packages of the distribution `OURS`, installed or in a checkout."""

OUR_FOLDER = Path(__file__).resolve().parents[2]
"""Folder that `PACKAGES` are imported from; a package of the same name elsewhere is the user's."""

INSTALLED = frozenset({"site-packages", "dist-packages"})
"""Folders that hold installed packages, wherever they lie."""


@dataclass(frozen=True)
class PluginSource:
    """The code behind a plug-in, as it was when it was looked up.

    It is the module itself, the packages around it, and in turn every module that one of these imports
    anywhere in its text, unless that is installed, part of Python or in one of `PACKAGES`. What runs only
    when a file is started as a script, under ``if __name__ == "__main__":``, does not belong to it: a script
    may hold both a teacher and the campaign that tries it.

    Attributes:
        module: name to import for the plug-in; for a script the name of its file.
        files: content by path below the folder that imports start from.
        installed: True for an installed package, which every machine needs by itself.
    """

    module: str
    files: Mapping[str, bytes]
    installed: bool

    @cached_property
    def digest(self) -> str:
        """Hash of paths and code: another one after every edit that can change what the plug-in does."""
        content = hashlib.sha256()
        for path in sorted(self.files):
            code = self.files[path]
            code = _imported_part(code) if path.endswith(".py") else code
            content.update(f"{path}\0{len(code)}\0".encode() + code)
        return content.hexdigest()[:16]

    @classmethod
    def of(cls, module: str, data_files: Iterable[str] = ()) -> "PluginSource":
        """Return the source of the module with a ``__name__``, and `data_files`: patterns in its folder.

        Raises:
            ValueError: the module has no file, or a pattern matches none.
        """
        name = importable_name(module)
        top = name.partition(".")[0]
        collector = _Collector(top)
        if module == "__main__" and sys.modules[module].__spec__ is None:
            collector.roots[top] = [Path(str(sys.modules[module].__file__)).absolute().parent]
        collector.add(name)
        if not collector.files:
            raise ValueError(f"module {name!r} has no Python file by which to tell its versions apart")
        root, file = collector.place(name)
        for pattern in data_files:
            found = [path for path in sorted(file.parent.glob(pattern)) if path.is_file()]
            if not found:
                raise ValueError(f"data_files: no file {pattern!r} in {file.parent}")
            collector.files |= {path.relative_to(root).as_posix(): read_file(path) for path in found}
        return cls(name, collector.files, _is_installed(root))


def importable_name(module: str) -> str:
    """Return the name by which another process can import `module`.

    Raises:
        ValueError: it was typed into an interactive session, or its file's name cannot be a module's.
    """
    if module != "__main__":
        return module
    main = sys.modules["__main__"]
    file = getattr(main, "__file__", None)
    if file is None:
        raise ValueError("it is defined in an interactive session; put it into a file that can be imported")
    name = main.__spec__.name if main.__spec__ else Path(file).stem  # python -m name, python name.py
    if not all(part.isidentifier() for part in name.split(".")) or name == "__main__":
        raise ValueError(f"it is defined in {file}, which no import can name; rename the file")
    return name


class _Collector:
    """Collector of the user's own files that a file imports; executes nothing.

    The package or module `top` is followed even if it is installed.

    Attributes:
        roots: folders that top-level names are imported from; none for what is not followed.
        files: files found.
    """

    def __init__(self, top: str) -> None:
        self._top = top
        self.roots: dict[str, list[Path]] = {}
        self.files: dict[str, bytes] = {}

    def place(self, module: str) -> tuple[Path, Path]:
        """Return the root of `module` and its file.

        Raises:
            FileNotFoundError: it is not followed, or not a module.
        """
        for root in self._roots_of(module.partition(".")[0]):
            path = root.joinpath(*module.split("."))
            for file in (path / "__init__.py", path.with_name(f"{path.name}.py")):
                if file.is_file():
                    return root, file
        raise FileNotFoundError(module)

    def add(self, module: str) -> None:
        """Add the file of `module`, those of the packages around it, and what they import."""
        parts = module.split(".")
        for length in range(1, len(parts) + 1):
            name = ".".join(parts[:length])
            try:
                root, file = self.place(name)
            except FileNotFoundError:  # installed, a namespace, or an attribute of the module before it
                continue
            path = file.relative_to(root).as_posix()
            if path not in self.files:
                self.files[path] = read_file(file)
                package = name if file.name == "__init__.py" else name.rpartition(".")[0]
                for imported in _imports(self.files[path], package):
                    self.add(imported)

    def _roots_of(self, top: str) -> list[Path]:
        """Return the followed folders with a top-level module or package: several for a namespace."""
        if top not in self.roots:
            found = None
            with suppress(ImportError, ValueError):  # no such module, or one without a spec
                found = importlib.util.find_spec(top)
            places = list(found.submodule_search_locations or ()) if found else []
            if found and not places and found.has_location and found.origin:
                places = [found.origin]
            folders = [Path(place).absolute().parent for place in places]
            if top in PACKAGES:
                folders = [folder for folder in folders if folder.resolve() != OUR_FOLDER]
            self.roots[top] = [folder for folder in folders if top == self._top or not _is_installed(folder)]
        return self.roots[top]


def _is_installed(folder: Path) -> bool:
    standard_library = Path(sysconfig.get_path("stdlib")).resolve()
    return bool(INSTALLED & set(folder.parts)) or folder.resolve().is_relative_to(standard_library)


def _imports(code: bytes, package: str) -> Iterator[str]:
    """Yield the names that `code`, of a module in `package`, imports; some may be no modules."""
    for node in ast.walk(ast.parse(_imported_part(code))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: 1 - node.level or None] if node.level else []  # one dot: `package`
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _imported_part(code: bytes) -> bytes:
    """Return `code` without what runs only when its file is started as a script."""
    lines = code.splitlines(keepends=True)
    end = len(lines)
    for node in reversed(ast.parse(code).body):
        start = min([node.lineno, *(part.lineno for part in getattr(node, "decorator_list", ()))]) - 1
        if isinstance(node, ast.If) and not node.orelse and ast.unparse(node.test) in MAIN_GUARDS:
            del lines[start:end]  # with the comments that follow
        end = start
    return b"".join(lines)

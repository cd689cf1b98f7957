"""Names of parts; which of the user's files are a plug-in, and when its hash changes."""

import importlib
import os
import subprocess
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path

import pytest

from tma_ray.components.plugin_source import OUR_FOLDER, PACKAGES, PluginSource
from tma_ray.components.registry import Registry, UnknownNameError


@pytest.fixture
def registry() -> Registry[type]:
    return Registry("shape", "tma_ray.test_shapes", {"fraction": "fractions:Fraction"})


def test_builtin_decorated_and_module_names_are_found(registry: Registry[type]) -> None:
    @registry.register("circle")
    class Circle: ...

    assert registry.get("circle") is Circle
    assert registry.get("fraction").__name__ == "Fraction"
    assert registry.get("decimal:Decimal").__name__ == "Decimal"
    assert registry.names() == ["circle", "fraction"]


def test_unknown_names_say_the_nearest(registry: Registry[type]) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'fraction'"):
        registry.get("fractoin")
    with pytest.raises(UnknownNameError, match="did you mean 'fraction'"):
        registry.get("FRACTION")
    with pytest.raises(UnknownNameError, match="no module 'no_such_module'"):
        registry.get("no_such_module:Thing")
    with pytest.raises(UnknownNameError, match="has no 'Decimall'"):
        registry.get("decimal:Decimall")


def test_a_name_is_taken_once(registry: Registry[type]) -> None:
    registry.register("circle")(int)
    with pytest.raises(ValueError, match="already"):
        registry.register("circle")(float)


def test_what_ships_with_the_package_needs_no_digest_and_no_import() -> None:
    shipped: Registry[type] = Registry("thing", "tma_ray.things", {"gone": "tma_ray.nowhere:Thing"})
    assert shipped.plugin("gone") is None
    assert shipped.plugin("tma_ray.teachers.random:Random") is None
    with pytest.raises(UnknownNameError, match="did you mean 'gone'"):
        shipped.plugin("gon")


def test_an_installed_package_offers_names_through_entry_points(registry, tmp_path, monkeypatch):
    package = tmp_path / "shapes-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: shapes\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[tma_ray.test_shapes]\nsquare = decimal:Decimal\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert registry.get("square").__name__ == "Decimal"
    assert registry.names() == ["fraction", "square"]


BESIDE = "import tma_ray.tasks, not_there, lab_N.envs.maze\n"

LAB = {
    "lab_N/__init__.py": "",
    "lab_N/unrelated.py": "import antigravity\n",
    "lab_N/envs/__init__.py": "",
    "lab_N/envs/maze.py": "from ..tools import walls\nfrom . import doors\nimport numpy\n",
    "lab_N/envs/doors.py": "HEIGHT = 2\n",
    "lab_N/tools/walls.py": "def late():\n    import beside_N\n",
    "beside_N.py": BESIDE,
    "plain_N.py": "import beside_N as other\n",
}
"""Relative and absolute imports, some inside functions, a folder without __init__.py, and a circle."""

Write = Callable[[dict[str, str]], str]
numbers = count()


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Write files into a folder on the import path; N in a name becomes a number of this test's own."""
    number = str(next(numbers))
    monkeypatch.syspath_prepend(tmp_path)

    def write(files: dict[str, str]) -> str:
        for path, text in files.items():
            file = tmp_path / path.replace("_N", f"_{number}")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text.replace("_N", f"_{number}"))
        importlib.invalidate_caches()
        return number

    return write


def test_a_plugin_is_what_its_module_imports_of_the_users_own(write: Write) -> None:
    number = write(LAB)
    modules = (f"lab_{number}.envs.maze", f"plain_{number}", f"lab_{number}.envs.doors")
    paths = [PluginSource.of(module).files for module in modules]
    files = [{path.replace(f"_{number}", "_N") for path in each} for each in paths]
    maze = set(LAB) - {"lab_N/unrelated.py", "plain_N.py"}
    doors = {"lab_N/__init__.py", "lab_N/envs/__init__.py", "lab_N/envs/doors.py"}
    assert files == [maze, maze | {"plain_N.py"}, doors]


@pytest.mark.parametrize(
    ("path", "text", "is_another"),
    [
        ("lab_N/envs/maze.py", "from ..tools import walls\nimport numpy as np\n", True),
        ("lab_N/tools/walls.py", "import beside_N\n", True),
        ("beside_N.py", "x = 1\n", True),
        ("lab_N/unrelated.py", "x = 1\n", False),
        ("lab_N/readme.txt", "x", False),
        ("beside_N.py", f"{BESIDE}if __name__ == '__main__':\n    import sys\n    # end\n", False),
        ("beside_N.py", f"if '__main__' == __name__:\n    ...\n{BESIDE}", False),
        ("beside_N.py", f"{BESIDE}if __name__ == '__main__':\n    x = 1\nelse:\n    x = 2\n", True),
    ],
)
def test_the_digest_tells_edits_apart(write: Write, path: str, text: str, is_another: bool) -> None:
    module = f"lab_{write(LAB)}.envs.maze"
    before = PluginSource.of(module).digest
    assert PluginSource.of(module).digest == before
    write({path: text})
    assert (PluginSource.of(module).digest != before) is is_another


def test_moving_code_between_files_makes_another_digest(write: Write) -> None:
    module = f"two_{write({'two_N.py': 'import one_N', 'one_N.py': 'a = 1'})}"
    before = PluginSource.of(module).digest
    write({"two_N.py": "import one_N\na = 1", "one_N.py": ""})
    assert PluginSource.of(module).digest != before


def test_data_files_are_part_of_it_if_it_names_them(write: Write, tmp_path: Path) -> None:
    number = write({"body_N.py": "class Body:\n    data_files = ('*.toml',)\n", "leg.toml": "length = 1"})
    digests = set()
    for text in ("length = 1", "length = 2"):
        write({"leg.toml": text})
        registry: Registry[type] = Registry("body", "tma_ray.bodies", {})
        source = registry.plugin(f"body_{number}:Body")
        assert source is not None
        assert set(source.files) == {f"body_{number}.py", "leg.toml"}
        digests.add(source.digest)
    assert len(digests) == 2
    (tmp_path / "leg.toml").unlink()
    with pytest.raises(ValueError, match=r"no file '\*.toml'"):
        PluginSource.of(f"body_{number}", ("*.toml",))


def test_an_installed_plugin_is_followed_within_its_own_package_only() -> None:
    source = PluginSource.of("pluggy._hooks")
    assert source.installed
    assert "pluggy/_hooks.py" in source.files
    assert all(path.startswith("pluggy/") for path in source.files)


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_our_packages_are_no_part_of_a_plugin(write: Write, package: str) -> None:
    """In a checkout they are not installed, and from a wheel they are: the digest must be the same."""
    imports = f"import {package}\nfrom {package} import statistics"
    number = write({"plug_N.py": f"{imports}\nimport own_N", "own_N.py": ""})
    assert set(PluginSource.of(f"plug_{number}").files) == {f"plug_{number}.py", f"own_{number}.py"}


def test_a_package_of_the_users_own_with_our_name_is_part_of_it(write: Write, tmp_path: Path) -> None:
    """Imports find `analysis` beside the plug-in first."""
    number = write({"analysis/__init__.py": "", "plug_N.py": "import analysis"})
    imported = "from tma_ray.components.plugin_source import PluginSource"
    code = f"{imported}; print(*PluginSource.of('plug_{number}').files)"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(OUR_FOLDER)])}
    command = [sys.executable, "-c", code]
    found = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, check=True)
    assert set(found.stdout.decode().split()) == {f"plug_{number}.py", "analysis/__init__.py"}


def test_what_has_no_python_file_is_refused() -> None:
    with pytest.raises(ValueError, match="'zlib' has no Python file"):
        PluginSource.of("zlib")


REGISTER = """
from tma_ray.components.registry import Registry
import beside
registry = Registry("teacher", "tma_ray.nothing", {})
registry.register("mine")(dict)
"""
TELL = """
source = registry.plugin("mine")
print(source.module, *sorted(source.files), source.digest)
"""


def python(*arguments: str, cwd: Path) -> str:
    """Return what Python prints, or the last line of its error."""
    result = subprocess.run([sys.executable, *arguments], cwd=cwd, capture_output=True, text=True)
    return result.stdout.strip() or result.stderr.strip().splitlines()[-1]


@pytest.mark.slow
def test_a_script_is_known_by_its_file(tmp_path: Path) -> None:
    folder = tmp_path / "far" / "away"
    folder.mkdir(parents=True)
    (folder / "beside.py").touch()
    for name in ("script.py", "not-a-name.py"):
        (folder / name).write_text(REGISTER + "if __name__ == '__main__':" + TELL.replace("\n", "\n    "))
    started_by_path = python(str(folder / "script.py"), cwd=tmp_path)
    assert started_by_path.split()[:-1] == ["script", "beside.py", "script.py"]
    assert python("-c", f"from script import registry\n{TELL}", cwd=folder) == started_by_path
    assert "rename the file" in python(str(folder / "not-a-name.py"), cwd=tmp_path)
    assert "put it into a file" in python("-c", REGISTER + TELL, cwd=folder)


def test_a_plugin_that_is_edited_without_a_new_import_keeps_its_digest(write: Write) -> None:
    module = f"late_{write({'late_N.py': 'class Thing: ...'})}"
    registry: Registry[type] = Registry("thing", "tma_ray.things", {})
    before = registry.plugin(f"{module}:Thing")
    assert before is not None
    write({"late_N.py": "class Thing:\n    edited = True\n"})
    assert registry.plugin(f"{module}:Thing") is before, "what runs here is what was imported"
    importlib.reload(sys.modules[module])
    after = registry.plugin(f"{module}:Thing")
    assert after is not None
    assert after.digest != before.digest

"""Cached kernels are compiled again when another module that they were compiled from has changed."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

HEADER = "from tma_ray.jit import kernel\n"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "package"
    (folder / "students").mkdir(parents=True)
    for each in (folder, folder / "students"):
        (each / "__init__.py").touch()
    return folder / "students"


@pytest.fixture
def printed(tmp_path: Path) -> Callable[[str], str]:
    path = os.pathsep.join([str(tmp_path), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def run(script: str) -> str:
        ended = subprocess.run(
            [sys.executable, "-c", script], check=True, capture_output=True, text=True, env=environment
        )
        return ended.stdout.strip()

    return run


def test_a_changed_callee_in_another_module_is_noticed(package: Path, printed: Callable[[str], str]) -> None:
    call = "\n\n@kernel\ndef double(x):\n    return 2 * value(x)\n"
    (package / "acting.py").write_text(f"{HEADER}from package.students.mlp import value\n{call}")

    def result(constant: int) -> str:
        (package / "mlp.py").write_text(f"{HEADER}\n\n@kernel\ndef value(x):\n    return x + {constant}\n")
        return printed("from package.students.acting import double; print(double(1))")

    assert [result(1), result(10)] == ["4", "22"]


def test_the_cache_of_another_version_whose_types_are_gone_is_left(
    package: Path, printed: Callable[[str], str]
) -> None:
    (package / "norms.py").write_text(f"{HEADER}\n\n@kernel\ndef norm(p):\n    return p.x + p.y\n")

    def result(module: str) -> str:
        (package / f"{module}.py").write_text(
            "from typing import NamedTuple\n\n\nclass Point(NamedTuple):\n    x: float\n    y: float\n"
        )
        imports = f"from package.students.norms import norm; from package.students.{module} import Point"
        return printed(f"{imports}; print(norm(Point(1.0, 2.0)))")

    assert result("points") == "3.0"
    (package / "points.py").unlink()
    assert result("vectors") == "3.0"

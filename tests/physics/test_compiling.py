"""Kernels are compiled when what they were compiled from has changed; the command says that it compiles."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from numba.core.caching import CompileResultCacheImpl
from suite.processes import python

from tma_ray.support.jit import kernel

KERNELS = """
from tma_ray.support.jit import kernel

@kernel
def added(first, second):
    return first + second
"""

SCRIPT = """
import sys
sys.orig_argv[1:1] = [{name!r}]
import kernels
assert (kernels.added(1, 2), kernels.added(1.5, 2)) == (3, 3.5)
"""


@pytest.mark.slow
def test_a_compilation_is_announced_once_by_the_command_and_not_when_it_is_cached(tmp_path: Path) -> None:
    (tmp_path / "kernels.py").write_text(KERNELS)

    def said(name: str) -> str:
        command = [sys.executable, "-c", SCRIPT.format(name=name)]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stderr

    assert said("worker") == ""
    (tmp_path / "__pycache__").rename(tmp_path / "elsewhere")
    first = said("tma-ray")
    assert first.count("compiling kernels, once per machine and version") == first.count("\n") == 1
    assert said("tma-ray") == ""


def test_without_a_folder_for_compiled_kernels_a_sentence_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CompileResultCacheImpl, "_locator_classes", [])
    with pytest.raises(OSError, match=r"cannot be kept: .*NUMBA_CACHE_DIR"):
        kernel(lambda x: x)


HEADER = "from tma_ray.support.jit import kernel\n"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "package"
    (folder / "students").mkdir(parents=True)
    for each in (folder, folder / "students"):
        (each / "__init__.py").touch()
    return folder / "students"


@pytest.fixture
def printed(tmp_path: Path) -> Callable[[str], str]:
    path, cache = os.pathsep.join([str(tmp_path), *sys.path]), str(tmp_path / "cache")
    return lambda script: python("-c", script, PYTHONPATH=path, NUMBA_CACHE_DIR=cache).strip()


@pytest.mark.slow
def test_a_changed_callee_in_another_module_is_noticed(package: Path, printed: Callable[[str], str]) -> None:
    call = "\n\n@kernel\ndef double(x):\n    return 2 * value(x)\n"
    (package / "acting.py").write_text(f"{HEADER}from package.students.mlp import value\n{call}")

    def result(constant: int) -> str:
        (package / "mlp.py").write_text(f"{HEADER}\n\n@kernel\ndef value(x):\n    return x + {constant}\n")
        return printed("from package.students.acting import double; print(double(1))")

    assert [result(1), result(10)] == ["4", "22"]


@pytest.mark.slow
def test_the_cache_of_types_that_are_gone_is_left(package: Path, printed: Callable[[str], str]) -> None:
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

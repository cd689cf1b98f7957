"""The command says that it compiles, since it is silent meanwhile, and where it cannot keep kernels."""

import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.caching import CompileResultCacheImpl

from tma_ray.jit import kernel

KERNELS = """
from tma_ray.jit import kernel

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

COUNTED = """
from tma_ray.jit import count_compiled
count_compiled(lambda compiled, known: print(compiled, known))
import kernels
kernels.added(1, 2)
"""


@pytest.mark.slow
def test_compiled_kernels_are_counted_among_those_that_are_known(tmp_path: Path) -> None:
    other = KERNELS.partition("@kernel")[2].replace("added", "more")
    (tmp_path / "kernels.py").write_text(f"{KERNELS}\n@kernel{other}")
    command = [sys.executable, "-c", COUNTED]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert ended.stdout == "1 2\n"


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

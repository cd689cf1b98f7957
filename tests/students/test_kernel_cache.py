"""Kernels cached on disk are compiled again when a kernel that they call has changed in another room."""

import os
import subprocess
import sys

import pytest


@pytest.mark.slow
def test_a_changed_callee_in_another_room_is_noticed(tmp_path):
    room = tmp_path / "package" / "students"
    (room / "ppo").mkdir(parents=True)
    for folder in (room.parent, room, room / "ppo"):
        (folder / "__init__.py").touch()
    header = "from tma_ray.jit import kernel\n"
    call = "\n\n@kernel\ndef double(x):\n    return 2 * value(x)\n"
    (room / "ppo" / "acting.py").write_text(f"{header}from package.students.mlp import value\n{call}")

    def result(constant: int) -> str:
        (room / "mlp.py").write_text(f"{header}\n\n@kernel\ndef value(x):\n    return x + {constant}\n")
        script = "from package.students.ppo.acting import double; print(double(1))"
        path = os.pathsep.join([str(tmp_path), *sys.path])
        environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        run = subprocess.run(
            [sys.executable, "-c", script], check=True, capture_output=True, text=True, env=environment
        )
        return run.stdout.strip()

    assert [result(1), result(10)] == ["4", "22"]

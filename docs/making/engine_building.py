"""Build of the page's WebAssembly from the kernels (translated to C) and Chipmunk's sources."""

import subprocess
import sys
import tarfile
import tempfile
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np
from kernel_translation import NOTHING, REAL, WHOLE, Translation, TupleType, Type
from numba import types

from tma_ray.embodiments import load_embodiment
from tma_ray.physics.base import settings_for
from tma_ray.physics.chipmunk import chains
from tma_ray.physics.compiled import symbols
from tma_ray.physics.compiled.step import new_memory, step
from tma_ray.physics.compiled.world import build as build_world
from tma_ray.physics.compiled.world import count_contact, release
from tma_ray.physics.rules import Rules, body_arrays, observation_size, step_arrays
from tma_ray.students.mlp.acting import apply_row
from tma_ray.terrain import parkour, stump_tracks
from tma_ray.terrain.terrain import Terrain

C_SOURCES: Final = Path(__file__).parent / "engine"

ZIG: Final = "0.17.1"  # version of the PyPI package `ziglang`; other versions build other bytes

UNUSED: Final = ("cpHastySpace.c", "cpPolyline.c", "cpMarch.c", "cpSpaceDebug.c")  # sources not needed
FLAGS: Final = (
    *("--target=wasm32-wasi", "-O2", "-std=c11", "-DNDEBUG", "-DCP_OVERRIDE_MESSAGE", "-mexec-model=reactor"),
    *("-ffp-contract=off", "-fno-builtin-sincos", "-g0", "-Wl,--strip-all", "-Wl,--gc-sections"),
    *("-ffunction-sections", "-fdata-sections", "-Wl,-z,stack-size=65536", "-Wno-everything"),
)


class CompilerMissingError(RuntimeError):
    """Error raised if the pinned version of the compiler is not installed."""


def build(folder: Path | None = None) -> bytes:
    """Build the engine as WebAssembly, with reproducible bytes.

    Args:
        folder: folder of Chipmunk's sources, ``Munk2D`` of pymunk's source distribution; None to download
            that of the installed version with pip.

    Raises:
        CompilerMissingError: if the pinned compiler is not installed.
        subprocess.CalledProcessError: if the sources cannot be downloaded or compiled.
    """
    require_zig()
    with tempfile.TemporaryDirectory() as name:
        build_folder = Path(name)
        munk = folder
        if munk is None:
            requirement = f"pymunk=={metadata.version('pymunk')}"
            pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:"]
            subprocess.run([*pip, "--dest", name, requirement], check=True)  # noqa: S603
            with tarfile.open(next(build_folder.glob("pymunk-*.tar.gz"))) as packed:
                packed.extractall(build_folder, filter="data")
            munk = next(build_folder.glob("pymunk-*/Munk2D"))
        (build_folder / "kernels.c").write_text(kernels_in_c())
        for file in ("chipmunk_calls.h", "sine.c"):
            (build_folder / file).write_bytes((C_SOURCES / file).read_bytes())
        sources = sorted(str(file) for file in (munk / "src").glob("*.c") if file.name not in UNUSED)
        command = [sys.executable, "-m", "ziglang", "cc", *FLAGS, f"-ffile-prefix-map={munk}=Munk2D"]
        files = ["-I", str(munk / "include"), "kernels.c", "sine.c", *sources, "-o", "engine.wasm"]
        subprocess.run([*command, *files], cwd=build_folder, check=True)  # noqa: S603
        return (build_folder / "engine.wasm").read_bytes()


def require_zig() -> None:
    """Check that the pinned version of the Zig compiler is installed."""
    version = metadata.version("ziglang") if find_spec("ziglang") else "none"
    if version != ZIG:
        raise CompilerMissingError(f"ziglang {version} is installed: pip install ziglang=={ZIG}")


def kernels_in_c() -> str:
    """Return C source code of all functions called by the page."""
    body = load_embodiment("climbing_chimpanzee")
    rules = Rules("parkour", load_embodiment("fish").lidars, True)
    settings, arrays, built = settings_for(body), step_arrays(body, rules), body_arrays(body)
    floats, integers = new_memory(arrays, len(built.limits), settings, 0)
    observation = np.empty(observation_size(arrays), np.float32)
    handles, nothing, line = np.zeros(1, np.int64), np.zeros((0, 4)), np.zeros(2)
    terrain = Terrain(np.zeros((0, 4, 2)), 1.0, nothing, line, 0.0, 0, nothing, nothing, handles[:0], 0.0)
    single, heights = np.zeros(1, np.float32), np.zeros(3)
    kinds = {types.void: NOTHING, types.intp: WHOLE, types.intc: WHOLE, types.float64: REAL}
    externals: dict[str, Type] = {
        name: kinds[value.sig.return_type]
        for name, value in vars(symbols).items()
        if isinstance(value, types.ExternalFunction)
    }
    vectors = ("body_rotation", "body_position", "body_velocity")
    externals |= dict.fromkeys(vectors, TupleType((REAL, REAL))) | {"other_shape": WHOLE}
    translation = Translation(externals)
    counter = translation.function(count_contact, (WHOLE, WHOLE, WHOLE))[0]
    translation.export("step", step, floats, integers, observation)
    creepers = chains(terrain)
    translation.export("build", build_world, built, terrain, creepers, settings, (0.0, 0.0), handles)
    translation.export("release", release, handles, handles, handles, handles.reshape(-1, 1), 0)
    translation.export("stump_tracks", stump_tracks._lay_out, heights, 0.0)
    translation.export("parkour", parkour._lay_out, heights, heights)
    translation.export("network", apply_row, single, handles, single.reshape(1, 1), handles, False, single)
    call = f"{counter}(ADDRESS(b), ADDRESS(a), ADDRESS(n));"
    callback = f"void count_arbiter(cpBody *b, cpArbiter *a, void *n) {{ {call} }}"
    return translation.text('#include "chipmunk_calls.h"') + callback + "\n"

"""Build of the page's WebAssembly: the kernels, translated to C, with Chipmunk's own sources."""

import hashlib
import subprocess
import sys
import tarfile
import tempfile
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np
from numba import types

from tma_ray.embodiments import load_embodiment
from tma_ray.physics.base import settings_for
from tma_ray.physics.chipmunk import chains
from tma_ray.physics.compiled import symbols
from tma_ray.physics.compiled.step import new_memory, step
from tma_ray.physics.compiled.world import build as build_world
from tma_ray.physics.compiled.world import count_contact, release
from tma_ray.physics.rules import Rules, body_arrays, observation_size, step_arrays
from tma_ray.playground.translation import NOTHING, REAL, WHOLE, Record, Translation, Type
from tma_ray.students.mlp.acting import apply_row
from tma_ray.terrain import parkour, stump_tracks
from tma_ray.terrain.base import Terrain

DATA: Final = Path(__file__).parent / "data"

WASM: Final = DATA / "engine.wasm"  # the built engine, which the package ships
ZIG: Final = "0.17.1"  # version of the PyPI package `ziglang` that compiles it: another one gives other bytes

UNUSED: Final = ("cpHastySpace.c", "cpPolyline.c", "cpMarch.c", "cpSpaceDebug.c")
"""Sources that a world on one thread does not need."""

FLAGS: Final = (
    *("--target=wasm32-wasi", "-O2", "-std=c11", "-DNDEBUG", "-DCP_OVERRIDE_MESSAGE", "-mexec-model=reactor"),
    *("-ffp-contract=off", "-fno-builtin-sincos", "-g0", "-Wl,--strip-all", "-Wl,--gc-sections"),
    *("-ffunction-sections", "-fdata-sections", "-Wl,-z,stack-size=65536", "-Wno-everything"),
)


class CompilerMissingError(RuntimeError):
    """The compiler, of the pinned version, is not installed."""


def build(folder: Path | None = None) -> bytes:
    """Return the engine as WebAssembly; the same sources give the same bytes.

    Args:
        folder: folder of Chipmunk's sources, ``Munk2D`` of pymunk's source distribution; None for downloading
            that of the installed version with pip.

    Raises:
        CompilerMissingError: the pinned compiler is not installed.
        subprocess.CalledProcessError: the sources cannot be downloaded or compiled.
    """
    require_zig()
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        munk = folder
        if munk is None:
            wanted = f"pymunk=={metadata.version('pymunk')}"
            pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:"]
            subprocess.run([*pip, "--dest", name, wanted], check=True)  # noqa: S603
            with tarfile.open(next(place.glob("pymunk-*.tar.gz"))) as packed:
                packed.extractall(place, filter="data")
            munk = next(place.glob("pymunk-*/Munk2D"))
        (place / "kernels.c").write_text(kernels_in_c())
        for file in ("chipmunk_calls.h", "sine.c"):
            (place / file).write_bytes((DATA / file).read_bytes())
        sources = sorted(str(file) for file in (munk / "src").glob("*.c") if file.name not in UNUSED)
        command = [sys.executable, "-m", "ziglang", "cc", *FLAGS, f"-ffile-prefix-map={munk}=Munk2D"]
        files = ["-I", str(munk / "include"), "kernels.c", "sine.c", *sources, "-o", "engine.wasm"]
        subprocess.run([*command, *files], cwd=place, check=True)  # noqa: S603
        return (place / "engine.wasm").read_bytes()


def require_zig() -> None:
    """Refuse to go on without the compiler of the pinned version."""
    found = metadata.version("ziglang") if find_spec("ziglang") else "none"
    if found != ZIG:
        raise CompilerMissingError(f"ziglang {found} is installed: pip install ziglang=={ZIG}")


def digest(content: bytes) -> str:
    """Return the SHA-256 of some bytes."""
    return hashlib.sha256(content).hexdigest()


def kernels_in_c() -> str:
    """Return everything that the page calls, as one file in C."""
    body, rules = (
        load_embodiment("climbing_chimpanzee"),
        Rules("parkour", load_embodiment("fish").lidars, True),
    )
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
    externals |= dict.fromkeys(vectors, Record((REAL, REAL))) | {"other_shape": WHOLE}
    translation = Translation(externals)
    counter = translation.function(count_contact, (WHOLE, WHOLE, WHOLE))[0]
    translation.export("step", step, floats, integers, observation)
    hung = chains(terrain)
    translation.export("build", build_world, built, terrain, hung, settings, (0.0, 0.0), handles)
    translation.export("release", release, handles, handles, handles, handles.reshape(-1, 1), 0)
    translation.export("stump_tracks", stump_tracks._lay_out, heights, 0.0)
    translation.export("parkour", parkour._lay_out, heights, heights)
    translation.export("network", apply_row, single, handles, single.reshape(1, 1), handles, False, single)
    call = f"{counter}(ADDRESS(b), ADDRESS(a), ADDRESS(n));"
    callback = f"void count_arbiter(cpBody *b, cpArbiter *a, void *n) {{ {call} }}"
    return translation.text('#include "chipmunk_calls.h"') + callback + "\n"

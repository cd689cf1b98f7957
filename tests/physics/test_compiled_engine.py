"""What the compiled engine promises beyond what every engine does."""

import copy
import gc
import os
import pickle
import tracemalloc
from collections.abc import Callable
from functools import cache
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from suite.processes import python
from trajectory import digest

import tma_ray
from tma_ray.embodiments import load_embodiment
from tma_ray.envs.stump_tracks import RULES, StumpTracks
from tma_ray.physics.compiled.engine import CompiledEngine
from tma_ray.terrain.stump_tracks import stump_tracks

BODY = load_embodiment("classic_bipedal")
STATM = Path("/proc/self/statm")


@cache
def some_world(seed: int = 0):
    return stump_tracks(np.array([1.5, 3.0], dtype=np.float32), np.random.default_rng(seed))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copy_is_an_engine_of_its_own(copied: Callable[[CompiledEngine], CompiledEngine]) -> None:
    engine = CompiledEngine(BODY, RULES)
    engine.reset(some_world(), 0.0)
    twin = copied(engine)
    assert digest(twin, 1) == digest(engine, 1)
    del engine
    twin.step(np.zeros(4))


def test_a_step_before_a_reset_or_after_a_failed_one_is_refused() -> None:
    engine = CompiledEngine(BODY, RULES)
    with pytest.raises(RuntimeError, match="no world yet: call reset"):
        engine.step(np.zeros(4))
    engine.reset(some_world(), 0.0)
    with pytest.raises(TypeError):
        engine.reset(some_world(), None)
    with pytest.raises(RuntimeError, match="no world yet: call reset"):
        engine.step(np.zeros(4))


def test_a_step_allocates_little_and_keeps_nothing() -> None:
    env = StumpTracks()
    env.reset(seed=0, options={"task": [0.0, 6.0]})
    action = env.action_space.sample() * 0
    for _ in range(10):
        env.step(action)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        peaks = []
        for _ in range(30):
            tracemalloc.reset_peak()
            start = tracemalloc.get_traced_memory()[0]
            env.step(action)
            peaks.append(tracemalloc.get_traced_memory()[1] - start)
        kept = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert max(peaks) < 2_000
    assert kept < 2_000


def resident_bytes() -> int:
    gc.collect()
    return int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def growth(repeat: Callable[[int], None], count: int) -> int:
    """Return how much memory `count` repeats add to those of a tenth as many, in bytes."""
    if not STATM.exists():
        pytest.skip(f"{STATM} does not exist: memory cannot be measured here")
    for index in range(count // 10):
        repeat(index)
    before = resident_bytes()
    for index in range(count):
        repeat(index)
    return resident_bytes() - before


def play_a_little(engine: CompiledEngine, seed: int) -> None:
    engine.reset(some_world(seed % 20), 0.0)
    for _ in range(3):
        engine.step(np.ones(4))


@pytest.mark.parametrize("count", [500, pytest.param(100_000, marks=pytest.mark.slow)])
def test_resets_leak_nothing(count: int) -> None:
    """A world takes over 100 kB, its smallest piece 100 bytes; other processes make memory grow by 1 MB."""
    engine = CompiledEngine(BODY, RULES)
    assert growth(lambda seed: play_a_little(engine, seed), count) < max(2_000_000, 50 * count)


@pytest.mark.slow
def test_engines_leak_nothing() -> None:
    assert growth(lambda seed: play_a_little(CompiledEngine(BODY, RULES), seed), 500) < 1_000_000


@pytest.mark.slow
def test_the_cache_notices_changes_of_any_kernel(tmp_path: Path) -> None:
    copytree(Path(tma_ray.__file__).parent, tmp_path / "tma_ray", ignore=lambda *_: ["__pycache__"])
    code = (
        "from tma_ray.envs.stump_tracks import StumpTracks\n"
        "from tma_ray.physics import engine_in_use\n"
        "env = StumpTracks()\n"
        "print(env.reset(seed=0)[0][1], engine_in_use().name)"
    )

    def observed() -> list[str]:
        return python("-c", code, cwd=tmp_path, PYTHONPATH=str(tmp_path)).split()

    value, engine = observed()
    kernels = tmp_path / "tma_ray/physics/kernels.py"
    kernels.write_text(kernels.read_text().replace("SCALE * head[5]", "SCALE * 2 * head[5]"))
    assert observed() == [str(np.float32(value) * 2), engine] == [str(2 * np.float32(value)), "compiled"]

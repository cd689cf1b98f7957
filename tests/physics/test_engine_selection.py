"""Which engine a process uses."""

import logging
import sys

import pytest
from suite.processes import python

from tma_ray.embodiments import load_embodiment
from tma_ray.envs.stump_tracks import RULES
from tma_ray.physics import engine_in_use, make_engine
from tma_ray.physics.compiled.engine import CompiledEngine
from tma_ray.physics.pymunk_engine import PymunkEngine


@pytest.fixture(autouse=True)
def fresh_choice(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("TMA_RAY_ENGINE", raising=False)
    engine_in_use.cache_clear()
    yield
    engine_in_use.cache_clear()


def engine() -> object:
    return make_engine(load_embodiment("classic_bipedal"), RULES)


def test_the_compiled_engine_is_taken_where_it_works() -> None:
    assert engine_in_use().name == "compiled"
    assert isinstance(engine(), CompiledEngine)


@pytest.mark.parametrize(("name", "kind"), [("pymunk", PymunkEngine), ("compiled", CompiledEngine)])
def test_the_environment_variable_decides(name: str, kind: type, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMA_RAY_ENGINE", name)
    assert isinstance(engine(), kind)
    assert engine_in_use().name == name


def test_an_unknown_engine_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMA_RAY_ENGINE", "box2d")
    with pytest.raises(ValueError, match="TMA_RAY_ENGINE=box2d: expected 'compiled' or 'pymunk'"):
        engine()


def differing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the compiled engine's results differ in their last bits."""
    advance = CompiledEngine.step

    def step(self, action):
        observation, reward, ended = advance(self, action)
        return observation, reward * (1 + 1e-15), ended

    monkeypatch.setattr(CompiledEngine, "step", step)


def test_an_engine_with_other_results_is_not_taken(monkeypatch, caplog):
    differing(monkeypatch)
    with caplog.at_level(logging.WARNING):
        assert isinstance(engine(), PymunkEngine)
        assert isinstance(engine(), PymunkEngine)
    (record,) = caplog.records
    assert record.message.startswith("Simulating with pymunk, several times slower")
    assert record.message.endswith("its trajectory is not pymunk's")
    assert engine_in_use().name == "pymunk"
    assert "not pymunk's" in engine_in_use().reason


def test_a_demanded_engine_that_fails_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    differing(monkeypatch)
    monkeypatch.setenv("TMA_RAY_ENGINE", "compiled")
    with pytest.raises(RuntimeError, match="TMA_RAY_ENGINE=compiled, but the compiled engine fails"):
        engine()


def test_a_machine_with_other_calling_conventions_takes_pymunk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    for name in ("symbols", "world", "step", "engine"):
        monkeypatch.delitem(sys.modules, f"tma_ray.physics.compiled.{name}")
        monkeypatch.delattr(f"tma_ray.physics.compiled.{name}", raising=False)
    assert engine_in_use().name == "pymunk"
    assert "riscv64" in engine_in_use().reason


def test_without_a_compiler_pymunk_is_taken() -> None:
    code = "from tma_ray.physics import engine_in_use\nprint(engine_in_use())"
    choice = python("-c", code, NUMBA_DISABLE_JIT="1")
    assert "name='pymunk'" in choice
    assert "NUMBA_DISABLE_JIT" in choice

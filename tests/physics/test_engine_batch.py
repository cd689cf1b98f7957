"""EngineBatch stepped together go the same ways as alone."""

import numpy as np
import pytest
from parkour_worlds import parkour_rules, parkour_world

from tma_ray.embodiments import load_embodiment
from tma_ray.envs.stump_tracks import RULES
from tma_ray.physics import make_engine
from tma_ray.physics.compiled.engine import EngineBatch
from tma_ray.terrain.stump_tracks import stump_tracks

COUNT = 6


def engines():
    """Engines in worlds of their own."""
    made = [make_engine(load_embodiment("classic_bipedal"), RULES) for _ in range(COUNT)]
    for index, engine in enumerate(made):
        task = np.array([0.5 * index, 6 - index], dtype=np.float32)
        engine.reset(stump_tracks(task, np.random.default_rng(index)), push=float(index))
    return made


def parkour_engines():
    """Climbers in worlds of Parkour of their own."""
    body = load_embodiment("climbing_chimpanzee")
    made = [make_engine(body, parkour_rules(body)) for _ in range(COUNT)]
    for index, engine in enumerate(made):
        terrain = parkour_world(index / COUNT, (1.0, 2.0, 0.0), swinging=index % 2 == 1, seed=index)
        engine.reset(terrain, push=float(index))
    return made


@pytest.mark.parametrize(("make", "actions_each"), [(engines, 4), (parkour_engines, 12)])
def test_they_equal_single_engines_bit_for_bit(make, actions_each: int) -> None:
    """With more threads than worlds in some of the calls."""
    alone, joined = make(), make()
    worlds, rng = EngineBatch(joined, threads=3), np.random.default_rng(0)
    for _ in range(60):
        rows = np.sort(rng.choice(COUNT, rng.integers(1, COUNT + 1), replace=False))
        actions = rng.uniform(-1, 1, (len(rows), actions_each)).astype(np.float32)
        observations, rewards, ended = worlds.step(rows, actions)
        expected = [alone[row].step(action) for row, action in zip(rows, actions, strict=True)]
        assert observations.tobytes() == np.stack([outcome[0] for outcome in expected]).tobytes()
        assert rewards.tolist() == [outcome[1] for outcome in expected]
        assert ended.tolist() == [outcome[2] for outcome in expected]
    for one, other in zip(alone, joined, strict=True):
        assert one.state.tobytes() == other.state.tobytes()


@pytest.mark.parametrize("actions", [np.zeros((2, 3)), np.zeros((2, 5)), np.full((2, 4), np.nan)])
def test_malformed_actions_are_refused(actions: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"shape|must be finite"):
        EngineBatch(engines()).step(np.array([0, 3]), actions.astype(np.float32))


def test_engines_without_a_world_are_refused() -> None:
    engine = make_engine(load_embodiment("classic_bipedal"), RULES)
    with pytest.raises(RuntimeError, match="call reset first"):
        EngineBatch([engine]).step(np.array([0]), np.zeros((1, 4), np.float32))

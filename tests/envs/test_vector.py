"""Vector environments play what their worlds would play alone, bit for bit, on tasks of their own."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import tma_ray  # noqa: F401  (registers the environments)
from tma_ray.envs import ENVIRONMENTS, make_environment, make_vector_environment
from tma_ray.envs.lock_step import EngineLockStep
from tma_ray.envs.vector import VectorEnvironment

COUNT = 4

IDS = {"stump_tracks": "tma_ray/StumpTracks-v0", "parkour": "tma_ray/Parkour-v0"}


def one_by_one(name: str) -> SyncVectorEnv:
    """Gymnasium's own vector environment, which resets what it is told to."""
    return SyncVectorEnv([lambda: make_environment(name)] * COUNT, autoreset_mode=AutoresetMode.DISABLED)


def same(given, expected) -> bool:
    """Tells whether two results, or dicts of arrays, are the same bits."""
    if isinstance(expected, dict):
        return given.keys() == expected.keys() and all(same(given[key], expected[key]) for key in expected)
    return given.dtype == expected.dtype and given.tobytes() == expected.tobytes()


@pytest.mark.parametrize("name", IDS)
def test_worlds_with_a_counter_each_equal_gymnasiums_own(name: str) -> None:
    """Episodes begin when others are under way: by a mask, since they ended, and by force."""
    worlds, expected = gymnasium.make_vec(IDS[name], num_envs=COUNT), one_by_one(name)
    assert isinstance(worlds.unwrapped, VectorEnvironment)
    rng, mask, begun = np.random.default_rng(0), np.ones(COUNT, np.bool_), 0
    seed: int | None = 7
    for step in range(500):
        if mask.any():
            begun += int(mask.sum())
            results = (
                worlds.reset(seed=seed, options={"reset_mask": mask}),
                expected.reset(seed=seed, options={"reset_mask": mask.copy()}),
            )
            assert all(same(given, wanted) for given, wanted in zip(*results, strict=True))
            seed = None
        actions = rng.uniform(-1, 1, worlds.action_space.shape).astype(np.float32)
        results = worlds.step(actions), expected.step(actions)
        assert all(same(given, wanted) for given, wanted in zip(*results, strict=True)), step
        mask = results[0][2] | results[0][3] | (rng.random(COUNT) < 0.01)
    assert begun > 2 * COUNT


def test_each_world_is_truncated_by_its_own_counter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tma_ray.envs.stump_tracks.StumpTracks.max_episode_steps", 20)
    worlds = make_vector_environment("stump_tracks", 2)
    still = np.zeros(worlds.action_space.shape, np.float32)
    worlds.reset(seed=0, options={"task": np.zeros((2, 2))})
    ends = []
    for step in range(45):
        if step == 10:
            worlds.reset(options={"reset_mask": np.array([False, True]), "task": np.zeros((2, 2))})
        *_, terminated, truncated, _ = worlds.step(still)
        ends += [(step, row) for row in np.flatnonzero(terminated | truncated)]
        if (terminated | truncated).any():
            assert truncated.any()
            worlds.reset(options={"reset_mask": truncated, "task": np.zeros((2, 2))})
    assert ends == [(19, 0), (29, 1), (39, 0)]


def test_every_world_has_the_task_that_it_is_given() -> None:
    worlds, tasks = make_vector_environment("stump_tracks", 3), np.array([[0, 6], [1.5, 3], [3, 0]])
    observations, info = worlds.reset(seed=1, options={"task": tasks})
    np.testing.assert_array_equal(info["task"], tasks.astype(np.float32))
    for row, task in enumerate(tasks):
        alone, _ = make_environment("stump_tracks").reset(seed=1 + row, options={"task": task})
        assert observations[row].tobytes() == alone.tobytes()
    others = tasks[::-1].copy()
    after, info = worlds.reset(
        seed=[9, 9, 9], options={"task": others, "reset_mask": np.array([True, False, False])}
    )
    assert info["_task"].tolist() == [True, False, False]
    assert info["task"][0].tolist() == others[0].tolist()
    assert after[1:].tobytes() == observations[1:].tobytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": np.zeros(2)}, r"tasks have shape \(3, 2\), one row for each world; got \(2,\)"),
        ({"task": [[0, 0], [0, 0], [99, 0]]}, "stump_height = 99 is outside its valid domain"),
        ({"tasks": np.zeros((3, 2))}, "unknown reset option 'tasks'"),
        ({"reset_mask": np.zeros(3, np.bool_)}, "at least one of them true"),
        ({"reset_mask": np.ones(2, np.bool_)}, r"expected \(3,\) of bool"),
        ({"reset_mask": [1, 0, 1]}, "type int64"),
    ],
)
def test_malformed_resets_are_refused(options: dict[str, object], message: str) -> None:
    worlds = make_vector_environment("stump_tracks", 3)
    worlds.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        worlds.reset(options=options)
    with pytest.raises(ValueError, match="2 seeds for 3 worlds"):
        worlds.reset(seed=[1, 2])


def test_what_cannot_be_stepped_moves_no_world() -> None:
    worlds = make_vector_environment("stump_tracks", 2)
    with pytest.raises(gymnasium.error.ResetNeeded, match="the first reset begins an episode in every world"):
        worlds.reset(options={"reset_mask": np.array([True, False])})
    still = np.zeros((2, 4), np.float32)
    with pytest.raises(gymnasium.error.ResetNeeded, match="worlds 0, 1 have ended or not begun"):
        worlds.step(still)
    worlds.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions have shape \(2, 4\), got \(2, 3\)"):
        worlds.step(still[:, :3])
    with pytest.raises(ValueError, match="actions must be finite"):
        worlds.step(np.full((2, 4), np.nan))
    with pytest.raises(ValueError, match="outside its valid domain"):
        worlds.reset(options={"task": [[0, 0], [99, 0]]})
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset_mask"):
        worlds.step(still)
    worlds.reset(options={"task": np.zeros((2, 2))})
    worlds.step(still)


def test_worlds_without_an_engine_are_stepped_in_turn() -> None:
    worlds = make_vector_environment("swing_up:SwingUp", 2)
    assert not isinstance(worlds._worlds, EngineLockStep)
    worlds.reset(seed=0)
    for _ in range(199):
        *_, truncated, _ = worlds.step(np.zeros((2, 1), np.float32))
        assert not truncated.any()
    assert worlds.step(np.zeros((2, 1), np.float32))[3].all()


def test_a_vector_is_not_drawn() -> None:
    with pytest.raises(ValueError, match="vectorization_mode='sync'"):
        gymnasium.make_vec(IDS["parkour"], num_envs=2, render_mode="rgb_array")
    with pytest.raises(ValueError, match="num_envs = 0"):
        make_vector_environment("parkour", 0)
    assert set(IDS) == set(ENVIRONMENTS.names())

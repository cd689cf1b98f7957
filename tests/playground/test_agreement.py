"""The page's engine, policies and worlds in node and in Chromium: the same numbers as Python's."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from episodes import world_record
from replays import in_chromium, in_node, recorded, sine_of_the_page

from tma_ray.embodiments import embodiment_names
from tma_ray.envs import make_environment
from tma_ray.playground.contents import constants, worlds
from tma_ray.playground.page import policy_record
from tma_ray.runs.checkpoints import find_policy
from tma_ray.terrain.parkour import creeper_points

ROOT = Path(__file__).parents[2]

POLICIES = {
    "relu": ROOT / "notebooks/data/ppo-lite/policies/ppo_random-s0-43ca06a21b5e",
    "ppo": ROOT / "tests/compatibility/version_1/release/policies/ppo_alp_gmm-s0-5e7c73111b9c",
    "sac": ROOT / "tests/compatibility/version_1/release/policies/sac_adr-s0-93c3a39a6c7a",
}


@pytest.fixture(scope="module")
def sine(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Variables under which Python's engine has the page's sine and cosine."""
    return sine_of_the_page(tmp_path_factory.mktemp("sine"))


def assert_same_bits(played: list[Any], files: list[Path], episodes: int) -> None:
    for file, found in zip(files, played, strict=True):
        assert len(found) == episodes
        for episode in found:
            differences = episode["state"], episode["observed"], episode["reward"]
            assert differences == (0, 0, 0), (file.stem, episode)
            assert episode["ending"], (file.stem, episode)


def test_every_body_moves_as_in_python(sine: dict[str, str], tmp_path: Path) -> None:
    files = recorded(tmp_path, 1, 40, tuple(embodiment_names()), sine)
    assert len(files) == 2 * len(embodiment_names())
    assert_same_bits(in_node(tmp_path, *files), files, 1)


@pytest.mark.slow
@pytest.mark.parametrize("body", embodiment_names())
def test_twenty_episodes_are_the_same_in_node_and_in_chromium(body, sine, browser, tmp_path):
    files = recorded(tmp_path, 20, 200, (body,), sine)
    for played in (in_node(tmp_path, *files), in_chromium(browser, *files)):
        assert_same_bits(played, files, 20)


@pytest.mark.parametrize("kind", POLICIES)
def test_policies_act_as_in_python(kind: str, tmp_path: Path) -> None:
    saved = find_policy(str(POLICIES[kind]), "results")
    environment = make_environment("stump_tracks", embodiment=saved.spec.embodiment)
    policy = saved.load(environment.observation_space, environment.action_space)
    (size,) = environment.observation_space.shape
    observations = np.random.default_rng(0).normal(size=(100, size)).astype(np.float32)
    content = {"policy": policy_record(saved, "results"), "observations": observations}
    file = tmp_path / "policy.json"
    file.write_text(json.dumps(content, default=np.ndarray.tolist))
    actions = np.array(in_node(tmp_path, file)[0], np.float32)
    expected = np.array([policy(each) for each in observations])
    if kind == "sac":  # whose tangent hyperbolic is another library's
        np.testing.assert_allclose(actions, expected, rtol=0, atol=2e-7)
    else:
        np.testing.assert_array_equal(actions, expected)


@pytest.mark.parametrize(
    ("name", "task"),
    [
        ("stump_tracks", [1.2, 2.5]),
        ("stump_tracks", [-1, 0]),
        ("parkour", [-0.1, 0.8, 0.1, 0.4, 0.25, 2, 3, 10]),
    ],
)
def test_worlds_are_those_of_python(name: str, task: list[float], tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    terrain = make_environment(name).unwrapped.build(np.array(task, np.float32), np.random.default_rng(5))  # type: ignore[attr-defined]
    if name == "parkour":
        drawn = rng.normal(task[5], 0.1, len(creeper_points(task[4], task[6])))
    else:
        drawn = rng.normal(max(0.0, task[0]), 0.1, len(terrain.solids) - 1)
    content = {"worlds": worlds(), "constants": constants(), "name": name, "task": task, "drawn": drawn}
    file = tmp_path / "world.json"
    file.write_text(json.dumps(content, default=np.ndarray.tolist))
    made, expected = in_node(tmp_path, file)[0], world_record(terrain)
    for field, value in expected.items():
        if isinstance(value, list):
            assert made[field]["shape"] == value[1], field
            np.testing.assert_allclose(made[field]["values"], value[2], atol=1e-3, err_msg=field)
        else:
            assert made[field] == (value if value is None else pytest.approx(value, abs=1e-3)), field

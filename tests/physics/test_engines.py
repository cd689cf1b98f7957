"""Promises of every engine with every body; engines stepped together go the same ways as alone."""

from pathlib import Path

import numpy as np
import pytest
from behaviour import joint_drift, limit_overshoot, penetration
from parkour_worlds import parkour_rules, parkour_world
from suite.bodies import FEW, bodies
from suite.processes import python
from trajectory import digest, digest_in_parkour

from tma_ray.embodiments import BodyType, Embodiment, Part, Polygon, embodiment_names, load_embodiment
from tma_ray.envs.stump_tracks import RULES
from tma_ray.physics import TIME_STEP
from tma_ray.physics import make_engine as engine_of
from tma_ray.physics.compiled.engine import CompiledEngine, EngineBatch
from tma_ray.physics.pymunk_engine import PymunkEngine
from tma_ray.physics.rules import body_arrays
from tma_ray.terrain import GROUND_HEIGHT
from tma_ray.terrain.stump_tracks import stump_tracks

ENGINES = (CompiledEngine, PymunkEngine)


@pytest.fixture(params=ENGINES, ids=lambda engine: engine.__name__)
def make_engine(request):
    return lambda body: request.param(body, RULES)


@pytest.fixture(params=bodies())
def body(request) -> Embodiment:
    return load_embodiment(request.param)


def flat_world():
    return stump_tracks(np.array([0.0, 6.0], dtype=np.float32), np.random.default_rng(0))


def world_below(height: float):
    """Return a world that a body spawns `height` m above."""
    terrain = flat_world()
    return terrain._replace(spawn=terrain.spawn + np.array([0.0, height]))


def test_a_reused_engine_repeats_bit_for_bit(make_engine, body: Embodiment) -> None:
    engine = make_engine(body)
    first = digest(engine, seed=1)
    digest(engine, seed=2)
    assert digest(engine, seed=1) == first == digest(make_engine(body), seed=1)
    assert digest(engine, seed=2) != first


@pytest.mark.parametrize(
    ("plain", "names"),
    [
        pytest.param(False, FEW, id="compiled"),
        pytest.param(True, FEW, id="plain", marks=pytest.mark.slow),  # a body takes seconds
        pytest.param(False, embodiment_names(), id="all", marks=pytest.mark.slow),
    ],
)
def test_another_process_repeats_bit_for_bit(plain: bool, names: list[str]) -> None:
    variables = {"NUMBA_DISABLE_JIT": "1"} if plain else {}
    printed = python(Path(__file__).with_name("trajectory.py"), *names, **variables)
    engines = {name: PymunkEngine(load_embodiment(name), RULES) for name in names}
    expected = [f"{name} {digest(engine, 1)} {digest_in_parkour(name)}" for name, engine in engines.items()]
    assert printed.splitlines() == expected


@pytest.mark.parametrize("steps", [500, pytest.param(2000, marks=pytest.mark.slow)])
def test_both_engines_go_the_same_way_bit_for_bit(body: Embodiment, steps: int) -> None:
    fast, oracle = (engine(body, RULES) for engine in ENGINES)
    assert digest(fast, 5, steps) == digest(oracle, 5, steps)


@pytest.mark.parametrize(
    ("water", "swinging"),
    [
        (0.0, False),
        (0.7, True),
        pytest.param(0.85, False, marks=pytest.mark.slow),
        pytest.param(1.0, True, marks=pytest.mark.slow),
    ],
)
def test_both_engines_go_the_same_way_in_parkour(body: Embodiment, water: float, swinging: bool) -> None:
    terrain = parkour_world(water, (1.0, 2.0, 0.0), swinging=swinging, seed=3)
    fast, oracle = (engine(body, parkour_rules(body)) for engine in ENGINES)
    assert digest(fast, 5, 120, terrain) == digest(oracle, 5, 120, terrain)


@pytest.mark.parametrize(
    "name", ["climbing_chimpanzee", pytest.param("climbing_chest_chimpanzee", marks=pytest.mark.slow)]
)
def test_both_engines_grip_the_same_creepers(name: str) -> None:
    """Falls past long creepers, fixed and swinging, with hands that close and open."""
    body, held = load_embodiment(name), set()
    for seed in range(4):
        terrain = parkour_world(0.8, (1.0, 4.0, 0.0), swinging=seed % 2 == 1, seed=seed)
        fast, oracle = (engine(body, parkour_rules(body)) for engine in ENGINES)
        assert digest(fast, seed, 150, terrain) == digest(oracle, seed, 150, terrain)
        held |= set(fast.grips[:, 1].tolist())
    assert len(held) > 1


@pytest.mark.parametrize(
    ("task", "steps"),
    [
        ((1.5, 1.0), 300),
        pytest.param((1.5, 1.0), 3500, marks=pytest.mark.slow),
        pytest.param((3.0, 0.0), 3500, marks=pytest.mark.slow),
        pytest.param((0.0, 6.0), 3500, marks=pytest.mark.slow),
    ],
)
def test_random_full_torque_breaks_nothing(body: Embodiment, task: tuple[float, float], steps: int) -> None:
    engine, arrays, rng = CompiledEngine(body, RULES), body_arrays(body), np.random.default_rng(4)
    drift, overshoot, depth, lowest = [], [], [], []
    for step in range(steps):
        if step % 500 == 0:
            terrain = stump_tracks(np.array(task, dtype=np.float32), np.random.default_rng(step // 500))
            engine.reset(terrain, 0.0)
        observation, reward, _ = engine.step(rng.choice([-1.0, 1.0], body.action_size))
        assert np.all(np.isfinite(observation))
        assert np.isfinite(reward)
        assert np.all(np.isfinite(engine.state))
        drift.append(joint_drift(engine.state, arrays).max())
        overshoot.append(limit_overshoot(engine.state, arrays).max())
        depth.append(penetration(engine.state, arrays, terrain).max())
        lowest.append(engine.state[:, 1].min())
    assert min(lowest) > GROUND_HEIGHT - 0.1
    assert max(depth) < 0.2
    assert np.percentile(depth, 99) < 0.06
    assert np.percentile(drift, 99) < 0.02
    most = 0.1 if body.substeps == 2 else 0.2  # few, or light and strong limbs
    assert np.percentile(overshoot, 99) < most


def test_a_positive_action_opens_its_joint(make_engine, body: Embodiment) -> None:
    engine, arrays = make_engine(body), body_arrays(body)
    for joint, (a, b) in enumerate(arrays.joint_parts[: arrays.motors]):
        for sign in (-1.0, 1.0):
            engine.reset(world_below(5.0), 0.0)
            before = engine.state[b, 2] - engine.state[a, 2]
            engine.step(sign * np.eye(body.action_size)[joint])
            moved = sign * (engine.state[b, 2] - engine.state[a, 2] - before)
            room = arrays.limits[joint, int(sign > 0)] - before
            assert moved > 0.01 if abs(room) > 0.1 else moved > -0.01


def test_a_motor_seeks_its_speed_and_a_limp_joint_none(make_engine, body: Embodiment) -> None:
    engine, arrays = make_engine(body), body_arrays(body)
    engine.reset(world_below(5.0), 0.0)
    a, b = arrays.joint_parts[0]
    angle, (low, high) = engine.state[b, 2] - engine.state[a, 2], arrays.limits[0]
    sign = 1.0 if high - angle > angle - low else -1.0
    for _ in range(3):
        engine.step(sign * np.eye(body.action_size)[0])
    speed = engine.state[b, 5] - engine.state[a, 5]
    assert speed == pytest.approx(sign * body.joints[0].motor_speed, rel=0.05)


def test_a_body_in_the_air_falls_freely(make_engine, body: Embodiment) -> None:
    engine, arrays = make_engine(body), body_arrays(body)
    engine.reset(world_below(50.0), 0.0)
    speed = [arrays.mass @ engine.state[:, 4] / arrays.mass.sum()]
    for _ in range(25):
        engine.step(np.zeros(body.action_size))
        speed.append(arrays.mass @ engine.state[:, 4] / arrays.mass.sum())
    assert np.diff(speed) == pytest.approx(-10 * TIME_STEP, rel=1e-6)
    assert np.all(engine.contacts == 0)


@pytest.mark.parametrize("friction", [0.1, 0.4])
def test_push_and_friction_follow_box2ds_rules(make_engine, friction: float) -> None:
    """A sliding box: v = F dt / m, then it slows by sqrt(f1 f2) g."""
    shape = Polygon(((-0.5, -0.1), (0.5, -0.1), (0.5, 0.1), (-0.5, 0.1)))
    box = Part("box", shape, (0.0, 0.0), density=2.0, friction=friction, head=True)
    engine = make_engine(Embodiment("box", BodyType.WALKER, 0.105, 0.0, True, (box,), ()))
    push = 100.0
    engine.reset(flat_world(), push)
    start = push * TIME_STEP / box.mass
    slowing = np.sqrt(friction * 2.5) * 10
    assert start - engine.state[0, 3] == pytest.approx(slowing * TIME_STEP, rel=0.1)
    steps = 10
    for _ in range(steps):
        engine.step([])
    assert start - engine.state[0, 3] == pytest.approx(slowing * TIME_STEP * (steps + 1), rel=0.05)
    assert engine.contacts[0].tolist() == [1, 0]


def test_contacts_are_there_while_a_part_touches(make_engine) -> None:
    body = load_embodiment("classic_bipedal")
    engine = make_engine(body)
    engine.reset(flat_world(), 0.0)
    for _ in range(5):
        engine.step(np.zeros(4))
    assert engine.contacts.tolist() == [[0, 0], [0, 0], [1, 0], [0, 0], [1, 0]]
    engine.reset(world_below(1.0), 0.0)
    assert not engine.contacts.any()


def test_bodies_start_within_their_limits(make_engine, body: Embodiment) -> None:
    engine, arrays = make_engine(body), body_arrays(body)
    engine.reset(flat_world(), 0.0)
    assert limit_overshoot(engine.state, arrays).max() < 0.02
    assert joint_drift(engine.state, arrays).max() < 0.005


@pytest.mark.parametrize("action", [[0.0] * 3, [0.0] * 5, 0.0, [[0.0] * 4], [0.0, 0.0, np.nan, 0.0]])
def test_malformed_actions_are_refused(make_engine, action) -> None:
    engine = make_engine(load_embodiment("classic_bipedal"))
    engine.reset(flat_world(), 0.0)
    with pytest.raises(ValueError, match=r"an action (has shape \(4,\), got|must be finite, got)"):
        engine.step(action)


@pytest.mark.parametrize("actions", [np.zeros((2, 3)), np.zeros((2, 5)), np.full((2, 4), np.nan)])
def test_malformed_actions_of_a_batch_are_refused(actions: np.ndarray) -> None:
    engines = [engine_of(load_embodiment("classic_bipedal"), RULES) for _ in range(3)]
    for engine in engines:
        engine.reset(flat_world(), push=0.0)
    with pytest.raises(ValueError, match=r"shape|must be finite"):
        EngineBatch(engines).step(np.array([0, 2]), actions.astype(np.float32))


def test_engines_without_a_world_are_refused() -> None:
    engine = engine_of(load_embodiment("classic_bipedal"), RULES)
    with pytest.raises(RuntimeError, match="call reset first"):
        EngineBatch([engine]).step(np.array([0]), np.zeros((1, 4), np.float32))

"""Forces of water against closed forms, and against an evaluation of the release's formulas in numpy."""

import numpy as np
import pytest

from tma_ray.embodiments import BodyType, Embodiment, Joint, LidarLayout, Part, Polygon
from tma_ray.physics import Rules
from tma_ray.physics.compiled.engine import CompiledEngine
from tma_ray.physics.kernels import water_forces
from tma_ray.physics.rules import step_arrays
from tma_ray.terrain import Terrain
from tma_ray.terrain.stump_tracks import stump_tracks

RULES = Rules("parkour", LidarLayout.FULL, observes_medium=True)


def corners(width: float, height: float) -> np.ndarray:
    """Return the corners (4, 2) of a box around the origin, counter-clockwise."""
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([width, height]) / 2


def box(width: float, height: float, density: float = 1.0) -> Embodiment:
    """Return a body that is one box."""
    shape = Polygon(tuple(map(tuple, corners(width, height).tolist())))
    part = Part("box", shape, (0.0, 0.0), density=density, friction=0.5, head=True)
    return Embodiment("box", BodyType.AMPHIBIAN, height / 2 + 0.01, 0.0, True, (part,), ())


def two_boxes(limits: tuple[float, float] = (-1.0, 1.0)) -> Embodiment:
    """Return a body with a limb of 0.8 m x 0.2 m that hangs on a motor at its left end."""
    head, limb = (Polygon(tuple(map(tuple, corners(*size).tolist()))) for size in ((0.4, 0.4), (0.8, 0.2)))
    parts = (
        Part("head", head, (0.0, 0.0), density=1.0, friction=0.5, head=True),
        Part("limb", limb, (0.5, 0.0), density=1.0, friction=0.5),
    )
    joint = Joint("head", "limb", (0.1, 0.0), limits, motor_torque=5.0, motor_speed=4.0)
    return Embodiment("two boxes", BodyType.AMPHIBIAN, 1.0, 0.0, True, parts, (joint,))


def pool(depth: float, height: float, water_y: float = 0.0) -> Terrain:
    """Return an open world whose ground is `depth` m under `water_y`, with a start `height` m over it."""
    terrain = stump_tracks(np.array([0.0, 6.0], dtype=np.float32), np.random.default_rng(0))
    terrain = terrain._replace(solids=terrain.solids[:1], surface=terrain.surface[:1], ground_solids=1)
    ground = water_y - depth
    return terrain._replace(
        solids=np.array([[[-50.0, ground - 5], [150.0, ground - 5], [150.0, ground], [-50.0, ground]]]),
        surface=np.array([[-50.0, ground, 150.0, ground]]),
        spawn=np.array([5.0, water_y + height]),
        water_y=water_y,
    )


DEEP = 100.0
"""Height of a surface over everything."""


def forces(body: Embodiment, state: np.ndarray, water: float, torques: tuple[float, ...] = ()) -> np.ndarray:
    arrays, written = step_arrays(body, RULES), np.full((len(state), 3), np.nan)
    rotations = np.stack([np.cos(state[:, 2]), np.sin(state[:, 2])], axis=1)
    wet = water_forces(state, rotations, np.array(torques), arrays, water, written)
    assert wet or not written.any()
    return written


def still(x: float = 3.0, y: float = 5.0, angle: float = 0.0) -> np.ndarray:
    return np.array([[x, y, angle, 0.0, 0.0, 0.0]])


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    return points @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def of_an_edge(start: np.ndarray, end: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return drag and lift as force and torque (3,); points relative to the centre of mass."""
    length, middle = np.linalg.norm(end - start), (start + end) / 2
    edge = (end - start) / length
    normal = np.array([edge[1], -edge[0]])
    velocity = motion[:2] + motion[2] * np.array([-middle[1], middle[0]])
    speed = np.linalg.norm(velocity)
    if speed == 0 or normal @ velocity < 0:
        return np.zeros(3)
    towards = velocity / speed
    drag = min((normal @ towards) * 0.25 * length * speed**2, 2000)
    lift = min((normal @ towards) * (edge @ towards) * 0.25 * length * speed**2, 500)
    force = -drag * towards + lift * np.array([-towards[1], towards[0]])
    return np.array([*force, np.cross([*middle, 0], [*force, 0])[2]])


def resistance(outline: np.ndarray, motion: np.ndarray) -> np.ndarray:
    edges = zip(outline, np.roll(outline, -1, axis=0), strict=True)
    return sum(of_an_edge(start, end, motion) for start, end in edges)


@pytest.mark.parametrize("angle", [0.0, 0.4, -1.3, 3.0])
def test_a_body_under_water_loses_the_weight_of_its_area_of_water(angle: float) -> None:
    force = forces(box(0.6, 0.4), still(angle=angle), DEEP)
    np.testing.assert_allclose(force, [[0.0, 10 * 0.6 * 0.4, 0.0]], atol=1e-12)


def test_a_body_above_the_water_feels_none() -> None:
    assert not forces(box(0.6, 0.4), still(), 4.7).any()
    assert not forces(box(0.6, 0.4), still(angle=0.7), -np.inf).any()


def test_half_a_box_under_water_carries_half() -> None:
    np.testing.assert_allclose(forces(box(0.6, 0.4), still(), 5.0), [[0.0, 1.2, 0.0]], atol=1e-12)
    on_its_corner = forces(box(0.4, 0.4), still(angle=np.pi / 4), 5.0)
    np.testing.assert_allclose(on_its_corner, [[0.0, 0.8, 0.0]], atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_a_tilted_box_is_lifted_and_turned_by_what_is_under_water(seed: int) -> None:
    rng = np.random.default_rng(seed)
    width, height, angle = rng.uniform(0.2, 1.5), rng.uniform(0.2, 1.5), rng.uniform(-np.pi, np.pi)
    surface = rng.uniform(-0.2, 0.2)
    grid = np.stack(np.meshgrid(*[(np.arange(400) + 0.5) / 400 - 0.5] * 2), axis=-1).reshape(-1, 2)
    points = turned(grid * [width, height], angle)
    under = points[points[:, 1] < surface]
    buoyancy = 10 * width * height * len(under) / len(points)
    force = forces(box(width, height), still(angle=angle), 5.0 + surface)[0]
    assert force == pytest.approx([0.0, buoyancy, buoyancy * under[:, 0].mean()], rel=5e-3, abs=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_drag_and_lift_of_a_moving_and_spinning_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle, motion = rng.uniform(-np.pi, np.pi), rng.normal(0, 3, 3)
    state = np.array([[3.0, 5.0, angle, *motion]])
    outline = turned(corners(0.7, 0.3), angle)
    expected = resistance(outline, motion) + np.array([0.0, 10 * 0.7 * 0.3, 0.0])
    np.testing.assert_allclose(forces(box(0.7, 0.3), state, DEEP)[0], expected, rtol=1e-9)


def test_only_what_is_under_water_drags() -> None:
    motion = np.array([2.0, -1.0, 0.5])
    state = np.array([[3.0, 5.0, 0.0, *motion]])
    lower = corners(0.7, 0.3)
    lower[2:, 1] = 0.05
    expected = resistance(lower, motion) + np.array([0.0, 10 * 0.7 * 0.2, 0.0])
    np.testing.assert_allclose(forces(box(0.7, 0.3), state, 5.05)[0], expected, rtol=1e-9)


def test_drag_and_lift_have_bounds() -> None:
    motion = np.array([300.0, -300.0, 0.0])
    expected = resistance(corners(2.0, 2.0), motion) + np.array([0.0, 40.0, 0.0])
    actual = forces(box(2.0, 2.0), np.array([[0.0, 0.0, 0.0, *motion]]), DEEP)[0]
    np.testing.assert_allclose(actual, expected, rtol=1e-9)
    drag = actual[:2] @ np.array([-1, 1]) / np.sqrt(2) - 40 / np.sqrt(2)
    assert drag == pytest.approx(2 * 2000)


def pushed(angle: float, torque: float, spin: float = 0.0) -> np.ndarray:
    """Return the push on the limb of two boxes that turns at `spin` rad/s by a motor of `torque` N m."""
    body = two_boxes()
    anchor = np.array([0.1, 0.0])
    state = np.zeros((2, 6))
    state[1, :2] = anchor + turned(np.array([[0.4, 0.0]]), angle)[0]
    state[1, 2], state[1, 5] = angle, spin
    with_push, without = (forces(body, state, DEEP, (value,))[1] for value in (torque, 0.0))
    return with_push - without


def expected_push(angle: float, torque: float, spin: float = 0.0) -> np.ndarray:
    lever, turn, inertia = turned(np.array([[0.4, 0.0]]), angle)[0], 1.2 * torque, 0.16 * (0.64 + 0.04) / 12
    pull, force = turn * np.array([-lever[1], lever[0]]), np.zeros(2)
    outline = turned(corners(0.8, 0.2), angle)
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        along = end - start
        size = max(0, along[1] * pull[0] - along[0] * pull[1]) * 0.05 * (turn + inertia * spin) ** 2
        force += np.clip(-size * pull, -20, 20)
    return np.array([*force, np.cross([*-lever, 0], [*force, 0])[2]])


@pytest.mark.parametrize("angle", [0.0, 0.5, -0.9])
@pytest.mark.parametrize(("torque", "spin"), [(1.0, 0.0), (-1.0, 0.0), (1.5, 8.0), (1.5, -8.0), (-5.0, 3.0)])
def test_a_motor_pushes_its_limb_at_the_joint(angle: float, torque: float, spin: float) -> None:
    np.testing.assert_allclose(pushed(angle, torque, spin), expected_push(angle, torque, spin), atol=1e-9)


def test_a_push_goes_against_the_turn_and_is_bounded() -> None:
    up, down = pushed(0.0, 1.0), pushed(0.0, -1.0)
    assert up[1] < 0 < down[1]
    np.testing.assert_allclose(up[:2], -down[:2])
    assert pushed(0.0, 80.0)[1] == -20
    assert pushed(0.5, 80.0)[:2] == pytest.approx([20, -20])


@pytest.mark.parametrize(("angle", "pushes"), [(0.999, True), (1.0, False), (1.01, False), (-1.0, False)])
def test_nothing_pushes_a_limb_at_its_limit(angle: float, pushes: bool) -> None:
    assert bool(np.any(pushed(angle, 1.0))) == pushes


def test_a_sinking_box_reaches_the_speed_at_which_drag_carries_it() -> None:
    engine = CompiledEngine(box(1.0, 0.2, density=2.0), RULES)
    engine.reset(pool(depth=30.0, height=-1.0), 0.0)
    for _ in range(200):
        engine.step([])
    assert engine.state[0, 4] == pytest.approx(-np.sqrt((2 - 1) * 0.2 * 10 / 0.25), rel=1e-3)


def test_a_box_of_half_waters_density_floats_half_under_water() -> None:
    engine = CompiledEngine(box(2.0, 0.4, density=0.5), RULES)
    engine.reset(pool(depth=5.0, height=0.5), 0.0)
    heights = []
    for _ in range(3000):
        engine.step([])
        heights.append(engine.state[0, 1])
    assert np.mean(heights[-1000:]) == pytest.approx(0.0, abs=0.01)
    assert 0.5 < np.ptp(heights[:500]) > 3 * np.ptp(heights[-500:])

"""Parkour's world: ground and ceiling from the network, creepers, water, over the whole valid domain."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parkour_worlds import SHIPPED, parkour_world
from suite.processes import python

from tma_ray.terrain import CEILING, FIXED, GROUND_HEIGHT, Terrain
from tma_ray.terrain.parkour import CPPN, CREEPER_HEIGHT_STD, SHAPES, TRACK_POINTS, creeper_points, outlines
from tma_ray.terrain.terrain import TERRAIN_STEP

LOW = np.array([-2, -2, -2, 0, 0, 0, 0, 2], dtype=np.float32)
HIGH = np.array([2, 2, 2, 1, 1, 4, 5, 40], dtype=np.float32)
MEDIUM = (-0.15, 0.8, 0.1)
bounds = zip(LOW.tolist(), HIGH.tolist(), strict=True)
domain = st.tuples(*(st.one_of(st.sampled_from(ends), st.floats(*ends, width=32)) for ends in bounds))
networks = st.one_of(st.just(SHIPPED), st.integers(0, 5).map(lambda seed: random_network(seed)))


def random_network(seed: int) -> CPPN:
    rng = np.random.default_rng(seed)
    return CPPN({name: rng.normal(0, 2, shape).astype(np.float32) for name, shape in SHAPES.items()})


def line_network(ground: float, ceiling: float) -> CPPN:
    """Return a network whose curves rise almost linearly over x, by about `ground` and `ceiling` in all.

    Only x acts: tanh(x / 1000) is a line, and each softplus is one around 0, with slope 1/2.
    """
    weights = {name: np.zeros(shape, dtype=np.float32) for name, shape in SHAPES.items()}
    weights["w1"][0, 0] = 0.001
    weights["w2"][0, 0] = 1.0
    weights["w3"][0, 0] = 0.001
    weights["w3"][1, 0] = -0.001  # takes off the constant log 2 of a softplus whose input is 0
    weights["w4"][0, 0] = 1000.0
    weights["w5"][0] = np.array([ground, ceiling]) / (0.5 * 0.5 * 0.001)
    return CPPN(weights)


world = partial(parkour_world, theta=MEDIUM, creepers=(0.25, 0.0, 1.0))


def doubled_areas(solids: np.ndarray) -> np.ndarray:
    """Return cross products (n, 4) of every solid's consecutive sides: all positive if strictly convex."""
    sides = np.roll(solids, -1, axis=1) - solids
    following = np.roll(sides, -1, axis=1)
    return sides[..., 0] * following[..., 1] - sides[..., 1] * following[..., 0]


@settings(max_examples=150, deadline=None)
@given(domain, networks, st.booleans())
def test_every_valid_task_gives_a_world_in_order(task: tuple[float, ...], cppn: CPPN, swinging: bool) -> None:
    theta, (water, *creepers, delta) = task[:3], task[3:]
    terrain = world(water, theta=theta, creepers=creepers, delta=delta, cppn=cppn, swinging=swinging)
    for values in terrain:
        assert np.all(np.isfinite(values))
    assert np.all(doubled_areas(terrain.solids) > 0)
    ground, ceiling = terrain.solids[: terrain.ground_solids], terrain.solids[terrain.ground_solids :]
    assert len(ground) == len(terrain.surface)
    assert len(ceiling) == len(terrain.ceiling)
    for line in (terrain.surface, terrain.ceiling):
        np.testing.assert_array_equal(line[1:, :2], line[:-1, 2:])
        assert np.all(line[:, 2] > line[:, 0])
        assert line[0, 0] <= -20
        assert line[-1, 2] >= terrain.goal_x + 20
    np.testing.assert_array_equal(terrain.surface[:, 0], terrain.ceiling[:, 0])
    assert np.all(terrain.ceiling[:, 1::2] >= terrain.surface[:, 1::2])
    assert ground[..., 1].min() < terrain.surface[:, 1::2].min() - 9
    assert ceiling[..., 1].max() > terrain.ceiling[:, 1::2].max() + 9
    check_creepers(terrain, swinging)


def check_creepers(terrain: Terrain, swinging: bool) -> None:
    left, bottom, right, top = terrain.creepers.T
    assert np.all(np.diff(left) >= 0)
    assert np.all(right - left >= 0.2 - 1e-12)
    assert np.all(top - bottom >= 0.2 - 1e-12)
    assert len(terrain.holders) == len(left)
    if not swinging:
        assert np.all(terrain.holders == FIXED)
        return
    assert np.all(top - bottom <= 1.0 + 1e-12)
    for part, holder in enumerate(terrain.holders):
        if holder == CEILING:
            assert part == 0 or left[part - 1] < left[part]
        else:
            assert holder == part - 1
            assert left[holder] == left[part]
            assert bottom[holder] == top[part]


def test_the_solids_fill_what_is_under_the_ground_and_over_the_ceiling() -> None:
    terrain = world()
    under, over = np.split(terrain.solids, [terrain.ground_solids])
    np.testing.assert_array_equal(from_the_left(under)[:, [3, 2]].reshape(-1, 4), terrain.surface)
    np.testing.assert_array_equal(from_the_left(over)[:, :2].reshape(-1, 4), terrain.ceiling)


def from_the_left(solids: np.ndarray) -> np.ndarray:
    return solids[np.argsort(solids[:, 0, 0])]


@pytest.mark.parametrize("delta", [2.0, 10.0, 40.0])
def test_the_track_begins_flat_with_a_ceiling_whose_height_depends_on_delta(delta: float) -> None:
    terrain = world(delta=delta)
    assert terrain.surface[0] == pytest.approx([-20, 10 / 3, 20 * TERRAIN_STEP, 10 / 3])
    height = 10 / 3 + 200 / delta
    assert terrain.ceiling[0] == pytest.approx([-20, height, 20 * TERRAIN_STEP, height])
    assert terrain.spawn == pytest.approx([10 * TERRAIN_STEP, 10 / 3])
    assert terrain.goal_x == pytest.approx(100.3333, abs=1e-4)
    assert terrain.surface[-1, 0] == pytest.approx(219 * TERRAIN_STEP)


@pytest.mark.parametrize("delta", [5.0, 10.0, 20.0])
def test_lines_divided_by_delta_in_closed_form(delta: float) -> None:
    ground, ceiling = outlines(np.zeros(3, np.float32), delta, line_network(30.0, -60.0))
    x = np.arange(200) / 199
    np.testing.assert_allclose(ground[20:], 10 / 3 + 30 / delta * x, atol=0.3 / delta)
    np.testing.assert_allclose(ceiling[20:], 10 / 3 + 200 / delta - 60 / delta * x, atol=0.6 / delta)
    np.testing.assert_array_equal(ground[:21], np.full(21, GROUND_HEIGHT))


def test_a_ceiling_that_would_be_underground_lies_on_the_ground() -> None:
    ground, ceiling = outlines(np.zeros(3, np.float32), 10.0, line_network(150.0, -150.0))
    met = ceiling == ground
    assert np.flatnonzero(met)[0] == pytest.approx(20 + 199 * 200 / 300, abs=3)
    assert np.all(met[np.flatnonzero(met)[0] :])
    assert np.all(ceiling[~met] > ground[~met])


@pytest.mark.parametrize("delta", [5.0, 10.0, 20.0])
def test_water_rises_from_far_below_to_the_highest_point_of_the_ceiling(delta: float) -> None:
    dry, full = world(water=0.0, delta=delta), world(water=1.0, delta=delta)
    highest = full.ceiling[:, 1::2].max()
    assert full.water_y == pytest.approx(highest)
    assert dry.water_y == pytest.approx(-1000 / delta + 0.01 * (highest + 1000 / delta))
    assert world(water=0.005, delta=delta).water_y == dry.water_y
    assert world(water=0.5, delta=delta).water_y == pytest.approx((highest - 1000 / delta) / 2)


@pytest.mark.parametrize(
    ("spacing", "steps"), [(0.0, 2), (0.01, 2), (0.46, 2), (0.47, 3), (0.93, 3), (1.0, 4), (5.0, 12)]
)
def test_creepers_stand_on_the_grid_at_the_rounded_spacing(spacing: float, steps: int) -> None:
    left, _, right, _ = world(creepers=(0.25, 1.0, spacing)).creepers.T
    assert left[0] == 0
    assert np.diff(left) == pytest.approx(steps * TERRAIN_STEP)
    assert right - left == pytest.approx(0.25)
    last = (TRACK_POINTS - 1) * TERRAIN_STEP
    assert left[-1] < last <= left[-1] + (steps + 1) * TERRAIN_STEP


@pytest.mark.parametrize(("width", "points"), [(0.0, 1), (0.25, 1), (0.9, 1), (1.0, 2)])
def test_creepers_hang_from_the_higher_of_two_points(width: float, points: int) -> None:
    _, ceiling = outlines(np.array(MEDIUM, np.float32), 10.0, SHIPPED)
    left, _, right, top = world(creepers=(width, 1.0, 0.0)).creepers.T
    index = np.rint(left / TERRAIN_STEP).astype(int)
    assert right - left == pytest.approx(max(0.2, width))
    np.testing.assert_array_equal(top, np.maximum(ceiling[index], ceiling[index + points]))
    np.testing.assert_array_equal(index, creeper_points(width, 0.0))


def test_heights_of_creepers_are_normal_around_the_mean() -> None:
    creepers = np.concatenate([world(creepers=(0.25, 2.0, 0.0), seed=seed).creepers for seed in range(20)])
    heights = creepers[:, 3] - creepers[:, 1]
    assert heights.mean() == pytest.approx(2.0, abs=4 * CREEPER_HEIGHT_STD / np.sqrt(len(heights)))
    assert heights.std() == pytest.approx(CREEPER_HEIGHT_STD, rel=0.1)


def test_creepers_have_a_smallest_height() -> None:
    creepers = world(creepers=(0.25, 0.0, 0.0)).creepers
    heights = creepers[:, 3] - creepers[:, 1]
    assert heights.min() == pytest.approx(0.2)
    assert np.mean(np.isclose(heights, 0.2)) > 0.9  # two standard deviations over the mean


def test_swinging_creepers_are_those_that_do_not_swing_in_parts() -> None:
    whole, cut = world(creepers=(0.25, 2.05, 1.0)), world(creepers=(0.25, 2.05, 1.0), swinging=True)
    first = np.flatnonzero(cut.holders == CEILING)
    np.testing.assert_array_equal(cut.creepers[first][:, [0, 2, 3]], whole.creepers[:, [0, 2, 3]])
    lowest = np.append(first[1:], len(cut.holders)) - 1
    excess = whole.creepers[:, 1] - cut.creepers[lowest, 1]
    rest = np.mod(whole.creepers[:, 3] - whole.creepers[:, 1], 1.0)
    np.testing.assert_allclose(excess, np.maximum(0, 0.2 - rest), atol=1e-9)
    assert {1, 2, 3} >= set(np.diff(np.append(first, len(cut.holders)))) >= {2, 3}


def test_only_creepers_depend_on_the_generator() -> None:
    first, other = (world(creepers=(0.25, 2.0, 1.0), seed=seed) for seed in (5, 6))
    np.testing.assert_array_equal(first.solids, other.solids)
    assert not np.array_equal(first.creepers, other.creepers)


DIGEST = """
import hashlib, numpy as np
from tma_ray.terrain.parkour import CPPN, parkour
task = np.array([-0.15, 0.8, 0.1, 0.5, 0.25, 2.1, 1, 10], dtype=np.float32)
terrain = parkour(task, np.random.default_rng(0), cppn=CPPN.load(), swinging_creepers=True)
digest = hashlib.sha256(b"".join(np.asarray(values).tobytes() for values in terrain)).hexdigest()
"""


def test_compiled_and_plain_kernels_give_the_same_bits() -> None:
    compiled: dict[str, str] = {}
    exec(DIGEST, compiled)
    assert python("-c", f"{DIGEST}print(digest)", NUMBA_DISABLE_JIT="1").strip() == compiled["digest"]

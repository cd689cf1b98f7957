"""What worlds demand of bodies: hand-made worlds, whose demands are known in closed form."""

import itertools

import numpy as np
import pytest
from parkour_demands import demands, difficulty, greatest_rise, smoothest_path

from tma_ray.terrain import FIXED, GROUND_HEIGHT, Terrain
from tma_ray.terrain.terrain import TERRAIN_STEP

GOAL_X = 215 * TERRAIN_STEP
Heights = np.ndarray | float


def world(ground: Heights = 0.0, ceiling: Heights = 20.0, water: float = -100.0, creepers=None) -> Terrain:
    """Return a world whose ground and ceiling (220,), one value a terrain step, are given over the start."""
    ends = np.array([-20.0, *(np.arange(20, 220) * TERRAIN_STEP), 219 * TERRAIN_STEP + 20])

    def segments(heights: Heights) -> np.ndarray:
        track = np.broadcast_to(heights, 220)[20:] + GROUND_HEIGHT
        values = np.concatenate([track[:1], track, track[-1:]])
        return np.column_stack([ends[:-1], values[:-1], ends[1:], values[1:]])

    hanging = np.zeros((1, 4)) if creepers is None else creepers
    outlines = {"solids": np.empty((0, 4, 2)), "surface": segments(ground), "ceiling": segments(ceiling)}
    creeping = {"creepers": hanging, "holders": np.full(len(hanging), FIXED)}
    spawn, water_y = np.array([10 * TERRAIN_STEP, GROUND_HEIGHT]), GROUND_HEIGHT + water
    rest = {"friction": 2.5, "spawn": spawn, "goal_x": GOAL_X, "ground_solids": 0, "water_y": water_y}
    return Terrain(**outlines, **creeping, **rest)


def ramp(height: float, first: int, steps: int) -> np.ndarray:
    """Return 0 up to point `first`, then a rise of `height` over `steps` steps."""
    return height * np.clip((np.arange(220) - first) / steps, 0, 1)


def creepers_every(distance: float) -> np.ndarray:
    left = np.arange(0, 110, distance)
    return np.column_stack([left, left * 0, left + 0.25, left * 0 + 1])


def test_a_flat_dry_high_world_demands_little_of_a_walker() -> None:
    expected = {"rise": 0, "drop": 0, "clearance": 3 / 20, "depth": 0}
    assert demands(world(), "walker") == pytest.approx(expected)


def test_rises_and_drops_count_over_a_walkers_length() -> None:
    assert greatest_rise(ramp(2.0, 100, 10)) == pytest.approx(1.0)
    assert greatest_rise(-ramp(2.0, 100, 10)) == 0
    assert demands(world(ramp(2.0, 100, 10)), "walker")["rise"] == pytest.approx(1.0 / 1.4)
    assert demands(world(-ramp(9.0, 100, 1)), "walker")["drop"] == pytest.approx(1.5)
    hill = ramp(1.2, 100, 1) - ramp(1.2, 102, 1)
    assert demands(world(hill), "walker")["rise"] == pytest.approx(1.2 / 1.4)
    assert demands(world(hill), "walker")["drop"] == pytest.approx(1.2 / 6.0)


def test_what_lies_behind_the_goal_demands_nothing() -> None:
    behind = demands(world(ramp(50.0, 216, 1), water=0.0), "walker")
    assert behind == demands(world(water=0.0), "walker")
    assert demands(world(ramp(50.0, 214, 1)), "walker")["rise"] > 1


@pytest.mark.parametrize(("water", "depth"), [(-1.0, 0.0), (0.75, 0.5), (3.0, 2.0)])
def test_walkers_wade_in_water(water: float, depth: float) -> None:
    assert demands(world(water=water), "walker")["depth"] == pytest.approx(depth)


@pytest.mark.parametrize("body_type", ["walker", "swimmer", "climber"])
def test_where_the_ceiling_lies_on_the_ground_nobody_passes(body_type: str) -> None:
    closed = world(ceiling=20 - ramp(20.0, 100, 3), water=0.0)
    assert demands(closed, body_type)["clearance"] == np.inf
    assert difficulty(demands(closed, body_type)) == np.inf


def test_swimmers_need_water_over_all_of_the_ground() -> None:
    hill = ramp(5.0, 100, 20)
    assert demands(world(hill, water=13.0), "swimmer")["clearance"] == pytest.approx(1.6 / 8)
    assert demands(world(hill, water=4.0), "swimmer")["clearance"] == np.inf
    assert demands(world(hill, ceiling=7.0, water=13.0), "swimmer")["clearance"] == pytest.approx(1.6 / 2)


def test_swimmers_rise_only_where_they_must() -> None:
    hill = ramp(15.0, 100, 10)
    wide = demands(world(hill, ceiling=40.0, water=60.0), "swimmer")
    assert (wide["climb"], wide["detour"]) == (0, 0)
    # From the middle, 5 m over the ground, to 0.8 m over the hill, along a slope of 1.5 m a step.
    tight = demands(world(hill, ceiling=10 + hill, water=60.0), "swimmer")
    assert tight["detour"] == pytest.approx((15.8 - 5) / 100)
    assert tight["climb"] == pytest.approx(5 * 1.5 / 10)


def test_no_way_is_calmer_than_the_calmest() -> None:
    rng = np.random.default_rng(0)
    grid = np.arange(7)
    for _ in range(50):
        low = rng.integers(0, 4, 5)
        high = low + rng.integers(0, 3, 5)
        low[0] = high[0] = 2
        way = smoothest_path(low.astype(float), high.astype(float))
        assert np.all((way >= low) & (way <= high))
        ways = itertools.product(*([v for v in grid if a <= v <= b] for a, b in zip(low, high, strict=True)))
        assert np.abs(np.diff(way)).sum() == min(np.abs(np.diff(other)).sum() for other in ways)


def test_climbers_need_room_to_hang_air_and_a_ceiling_to_follow() -> None:
    easy = demands(world(ceiling=10.4, water=6.4, creepers=creepers_every(2.0)), "climber")
    assert easy == pytest.approx({"clearance": 0.5, "water": 0.5, "climb": 0, "creepers": 0.5})
    assert demands(world(ceiling=10.0, water=10.0), "climber")["water"] == np.inf
    steep = world(ceiling=10 + ramp(4.0, 60, 1) - ramp(6.0, 120, 1), creepers=creepers_every(9.0))
    assert demands(steep, "climber")["climb"] == pytest.approx(6 / 8)
    assert demands(steep, "climber")["creepers"] == 1


def test_difficulty_is_the_mean_of_what_a_body_can_meet() -> None:
    assert difficulty({"rise": 0.2, "drop": 1.0}) == pytest.approx(0.6)
    assert difficulty({"rise": 0.2, "drop": 1.01}) == np.inf


def test_an_unknown_type_of_body_is_refused() -> None:
    with pytest.raises(ValueError, match="'bird': expected one of walker, swimmer, climber"):
        demands(world(), "bird")

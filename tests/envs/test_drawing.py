"""Where frames look and what they show."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from parkour_worlds import parkour_rules, parkour_world

from tma_ray.embodiments import load_embodiment
from tma_ray.envs.drawing import (
    DEAD_HEAD,
    GOAL,
    GRIP_FREE,
    GRIP_HOLDING,
    GRIP_TOUCHING,
    HEAD,
    HEIGHT,
    LIDAR,
    LIDAR_CREEPER,
    LIDAR_WATER,
    PIXELS_PER_METRE,
    Colour,
    Renderer,
    height_at,
    view_of,
)
from tma_ray.envs.scene import RenderOptions, Scene, scene_of
from tma_ray.physics import engine_in_use, make_engine
from tma_ray.terrain import Terrain
from tma_ray.terrain.stump_tracks import stump_tracks

world = partial(parkour_world, theta=(-0.1, 0.8, 0.1), creepers=(0.25, 2.0, 1.0))


def scene(body: str, terrain: Terrain, steps: int = 0) -> Scene:
    embodiment = load_embodiment(body)
    engine = make_engine(embodiment, parkour_rules(embodiment))
    observation = engine.reset(terrain, 0.0)
    for _ in range(steps):
        observation, *_ = engine.step(np.ones(embodiment.action_size))
    return scene_of(engine, terrain, observation)


def frame_of(body: str, shown: Scene) -> np.ndarray:
    return Renderer(load_embodiment(body), False, 50).draw(shown, RenderOptions())


def pixels(frame: np.ndarray, colour: Colour, tolerance: int = 8) -> int:
    return int(np.sum(np.all(np.abs(frame.astype(int) - colour) <= tolerance, axis=-1)))


@pytest.mark.slow
def test_the_camera_moves_smoothly_and_keeps_the_head_in_the_frame() -> None:
    for delta in (5, 10, 40):
        terrain = world(delta=delta)
        xs = np.arange(0.0, terrain.goal_x, 0.05)
        for segments, above in ((terrain.surface, 1.5), (terrain.ceiling, -1.5)):
            ys = height_at(segments, xs) + above
            views = np.array([view_of(np.array(head), terrain) for head in zip(xs, ys, strict=True)])
            left, bottom, scale = views.T
            heights = HEIGHT / scale
            assert np.all((ys > bottom + 0.1 * heights) & (ys < bottom + 0.9 * heights))
            np.testing.assert_allclose((xs - left) * scale, 180)
            steepest = np.abs(np.diff(ys)).max()
            assert np.all(np.abs(np.diff(bottom)) < steepest + 0.3)
            assert np.all(np.abs(np.diff(heights)) < 0.3)


def test_a_low_passage_is_seen_whole_and_nearer() -> None:
    terrain = world(delta=40)
    low = int(np.argmin(terrain.ceiling[5:-5, 1] - terrain.surface[5:-5, 1])) + 5
    x, floor, roof = terrain.surface[low, 0], terrain.surface[low, 1], terrain.ceiling[low, 1]
    view = view_of(np.array([x, (floor + roof) / 2]), terrain)
    assert view.bottom < floor < roof < view.top
    assert view.scale > view_of(np.array([x, 5.0]), world()).scale


def test_under_an_open_sky_the_ground_stays_where_it_is() -> None:
    terrain = stump_tracks(np.array([1.0, 2.0], np.float32), np.random.default_rng(0))
    views = [view_of(np.array([x, y]), terrain) for x, y in ((5, 5.0), (30, 7.0))]
    assert views[0].bottom == views[1].bottom
    assert {view.scale for view in views} == {PIXELS_PER_METRE}
    assert view_of(np.array([30, 15.0]), terrain).top > 15


def test_the_height_of_the_ground_is_that_of_its_segments() -> None:
    terrain = world()
    left, y0, right, y1 = terrain.surface[70]
    np.testing.assert_allclose(height_at(terrain.surface, [left, (left + right) / 2]), [y0, (y0 + y1) / 2])


def test_the_dead_are_grey() -> None:
    shown = scene("classic_bipedal", world())
    assert not shown.dead
    alive, dead = (frame_of("classic_bipedal", replace(shown, dead=dead)) for dead in (False, True))
    assert pixels(alive, HEAD) > 200 > 5 > pixels(alive, DEAD_HEAD)
    assert pixels(dead, DEAD_HEAD) > 200


def test_a_body_that_has_drowned_is_dead() -> None:
    assert scene("classic_bipedal", world(water=1.0), steps=602).dead
    assert not scene("fish", world(water=1.0), steps=602).dead


def test_grips_show_what_they_do() -> None:
    shown = scene("climbing_chimpanzee", world())
    assert shown.grips.all()  # it starts hanging
    states = {GRIP_FREE: (0, 0), GRIP_TOUCHING: (1, 0), GRIP_HOLDING: (1, 1)}
    for colour, state in states.items():
        frame = frame_of("climbing_chimpanzee", replace(shown, grips=np.array([state] * 2, bool)))
        assert [other for other in states if pixels(frame, other) > 5] == [colour]


def test_lidars_have_the_colour_of_what_they_hit() -> None:
    shown = scene("classic_bipedal", world())
    frames = [frame_of("classic_bipedal", replace(shown, hits=np.full(10, hit, "f4"))) for hit in (-1, 0, 1)]
    for colour, frame in zip((LIDAR_WATER, LIDAR, LIDAR_CREEPER), frames, strict=True):
        counts = [pixels(other, colour, 40) for other in frames]
        assert pixels(frame, colour, 40) == max(counts)
        assert sorted(counts)[-1] > sorted(counts)[-2] + 20


def test_water_tints_what_is_under_it() -> None:
    dry = scene("fish", world())
    half = replace(dry, terrain=dry.terrain._replace(water_y=float(dry.poses[0, 1])))
    without, with_water = (frame_of("fish", shown).astype(int) for shown in (dry, half))
    view = view_of(dry.poses[0, :2], dry.terrain)
    row = round((view.top - half.terrain.water_y) * view.scale)
    np.testing.assert_array_equal(with_water[: row - 3], without[: row - 3])
    assert np.all(np.any(with_water[row + 3 :] != without[row + 3 :], axis=-1))


@pytest.mark.parametrize("engine", ["compiled", "pymunk"])
def test_swinging_creepers_are_drawn_where_they_are(engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMA_RAY_ENGINE", engine)
    engine_in_use.cache_clear()
    terrain = world(swinging=True)
    terrain = terrain._replace(spawn=np.array([terrain.creepers[6, 0] + 0.1, terrain.spawn[1]]))
    still, moved = (scene("climbing_chimpanzee", terrain, steps) for steps in (0, 40))
    engine_in_use.cache_clear()
    np.testing.assert_allclose(still.creepers[-1], moved.creepers[-1], atol=1e-6)  # far away, at rest
    assert np.abs(moved.creepers[:, 3]).max() > 0.05  # one is turned
    seen = [frame_of("climbing_chimpanzee", replace(moved, creepers=at.creepers)) for at in (still, moved)]
    assert np.any(seen[0] != seen[1])


def test_the_goal_stands_on_the_ground() -> None:
    terrain = world()
    shown = scene("spider", terrain)
    ground = float(height_at(terrain.surface, terrain.goal_x))
    assert abs(ground - terrain.spawn[1]) > 1
    lift = np.array([terrain.goal_x - 3 - shown.poses[0, 0], ground + 1 - shown.poses[0, 1], 0.0])
    poses = shown.poses + lift
    frame = frame_of("spider", replace(shown, poses=poses, lidars=shown.lidars + lift[:2]))
    view = view_of(poses[load_embodiment("spider").head, :2], terrain)
    x, y = ((terrain.goal_x + 0.3 - view.left) * view.scale, (view.top - ground - 3.2 + 0.35) * view.scale)
    assert pixels(frame[int(y) - 3 : int(y) + 3, int(x) - 3 : int(x) + 3], GOAL) == 36

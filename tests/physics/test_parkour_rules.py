"""Life and death, contacts and starts in Parkour."""

import numpy as np
import pytest
from parkour_worlds import deep, dry, parkour_rules

from tma_ray.embodiments import BodyType, embodiment_names, load_embodiment
from tma_ray.physics.compiled.engine import CompiledEngine
from tma_ray.physics.kernels import CEILING, FORWARD_WEIGHT, NOTHING
from tma_ray.terrain import GROUND_HEIGHT

UNDER_WATER, DEAD = 4, 5
"""Places in an observation."""


BODIES = {name: load_embodiment(name) for name in embodiment_names()}
CLIMBERS = [name for name, body in BODIES.items() if body.body_type is BodyType.CLIMBER]
TOUCHING_IS_NOTHING = [name for name in BODIES if name not in CLIMBERS and name != "walking_chimpanzee"]


def engine_for(name: str) -> CompiledEngine:
    return CompiledEngine(BODIES[name], parkour_rules(BODIES[name]))


def lived(name: str, terrain, steps: int) -> list[float]:
    """Return after each step without torque whether the body is seen to be dead."""
    engine = engine_for(name)
    seen = [engine.reset(terrain(), 0.0)[DEAD]]
    return seen + [engine.step(np.zeros(BODIES[name].action_size))[0][DEAD] for _ in range(steps)]


@pytest.mark.parametrize(
    ("name", "terrain"),
    [("fish", dry), ("classic_bipedal", deep), ("spider", deep), ("climbing_chimpanzee", deep)],
)
def test_the_601st_step_in_the_wrong_medium_kills_and_the_602nd_shows_it(name: str, terrain) -> None:
    assert lived(name, terrain, 605) == [0.0] * 602 + [1.0] * 4


@pytest.mark.parametrize(
    ("name", "terrain"),
    [("fish", deep), ("classic_bipedal", dry), ("amphibious_bipedal", dry), ("amphibious_bipedal", deep)],
)
def test_the_right_medium_does_not_kill(name: str, terrain) -> None:
    assert not any(lived(name, terrain, 650))


def test_a_breath_of_air_starts_the_count_anew() -> None:
    engine = engine_for("classic_bipedal")
    engine.reset(deep(), 0.0)
    engine.medium[0] = 600
    engine.medium[:] = 0, 1
    assert not any(engine.step(np.zeros(4))[0][DEAD] for _ in range(500))


def test_the_dead_do_not_act_and_pay_nothing() -> None:
    engines = [engine_for("fish") for _ in range(2)]
    for engine in engines:
        engine.reset(dry(), 0.0)
        engine.medium[1] = 601
    for _ in range(50):
        before = engines[0].state[BODIES["fish"].head, 0]
        acting = zip(engines, (1.0, 0.0), strict=True)
        (seen, reward, _), (resting, unmoved, _) = (each.step(np.full(4, action)) for each, action in acting)
        assert seen.tobytes() == resting.tobytes()
        assert reward == unmoved
        assert reward == pytest.approx(FORWARD_WEIGHT * (engines[0].state[0, 0] - before))
    assert seen[DEAD] == 1.0


def test_dead_hands_let_go() -> None:
    engine = engine_for("climbing_chimpanzee")
    engine.reset(dry(), 0.0)
    engine.medium[0] = 601
    assert np.all(engine.grips[:, 1] == CEILING)
    engine.step(np.ones(12))
    assert np.all(engine.grips[:, 1] == NOTHING)


@pytest.mark.parametrize(("terrain", "under"), [(dry, 0.0), (deep, 1.0)])
def test_a_head_knows_whether_it_is_under_water(terrain, under: float) -> None:
    for name in BODIES:
        assert engine_for(name).reset(terrain(), 0.0)[UNDER_WATER] == under


@pytest.mark.parametrize("name", CLIMBERS)
def test_a_climber_may_touch_the_ceiling_but_not_the_ground(name: str) -> None:
    engine, critical = engine_for(name), [part.critical for part in BODIES[name].parts]
    assert any("parkour" in environments for environments in critical)
    engine.reset(dry(), 0.0)
    touched_ceiling, rng = False, np.random.default_rng(0)
    for _ in range(400):
        action = rng.choice([-1.0, 1.0], BODIES[name].action_size)
        action[-2:] = 1.0
        _, reward, ended = engine.step(action)
        assert not ended
        touched_ceiling |= bool(engine.contacts[:, 1].any())
        assert not engine.contacts[:, 0].any()
    assert touched_ceiling
    while not ended:
        _, reward, ended = engine.step(np.zeros(BODIES[name].action_size))
    assert reward == -100
    assert engine.contacts[:, 0].any()


@pytest.mark.parametrize("name", TOUCHING_IS_NOTHING)
def test_touching_ends_no_other_bodys_episode(name: str) -> None:
    engine, rng = engine_for(name), np.random.default_rng(1)
    engine.reset(dry(), 0.0)
    touched = np.zeros(len(engine.state), dtype=bool)
    for _ in range(300):
        _, _, ended = engine.step(rng.choice([-1.0, 1.0], BODIES[name].action_size))
        touched |= engine.contacts[:, 0] > 0
        if ended:
            assert engine.state[BODIES[name].head, 0] < 0
            break
    assert touched.any()


def test_the_walking_chimpanzee_must_not_fall() -> None:
    engine, ended, steps = engine_for("walking_chimpanzee"), False, 0
    engine.reset(dry(), 0.0)
    while not ended:
        _, reward, ended = engine.step(np.zeros(BODIES["walking_chimpanzee"].action_size))
        steps += 1
    assert reward == -100
    assert steps < 100


def test_all_but_the_fish_are_pushed() -> None:
    for name in BODIES:
        states = []
        for push in (0.0, 5.0):
            engine = engine_for(name)
            engine.reset(dry(), push)
            states.append(engine.state.tobytes())
        assert (states[0] == states[1]) == (name == "fish")


def test_bodies_start_over_the_middle_of_the_start() -> None:
    for name, body in BODIES.items():
        engine = engine_for(name)
        engine.reset(dry(), 0.0)
        x, y = engine.state[body.head, :2]
        assert x == pytest.approx(4.667 + body.parts[body.head].position[0], abs=0.3)
        assert GROUND_HEIGHT < y < 23.4

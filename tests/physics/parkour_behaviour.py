"""Measurements of bodies in Parkour by the protocols that were used for the original release.

``python tests/physics/parkour_behaviour.py`` prints the tables of docs/fidelity.md.
"""

import sys
from collections.abc import Iterator

import numpy as np
from behaviour import Figures, cells, embodied, episodes, gaits, measured, start, zero_action
from parkour_worlds import deep, dry, parkour_rules

from tma_ray.embodiments import Embodiment, embodiment_names, load_embodiment
from tma_ray.physics import Engine
from tma_ray.physics.kernels import NOTHING
from tma_ray.physics.pymunk_engine import PymunkEngine
from tma_ray.terrain import Terrain

CLIMBERS = ("climbing_chimpanzee", "climbing_chest_chimpanzee")
RELEASED = ("old_classic_bipedal", "climbing_chimpanzee", "amphibious_bipedal", "fish")
"""Bodies that are released in open water."""

RELEASE_HEIGHT, RELEASE_STEPS = 8.0, (10, 25, 50)
"""Height above the start at which a body is released, in m, and steps after which it is measured."""

FISH_STEPS = (100, 200, 300, 500)
"""Steps after which a fish that starts on the ground is measured."""

BODIES = tuple(embodiment_names())


def place_of(name: str) -> Terrain:
    """Return the world of a body: deep water for the fish, else a dry one."""
    return deep() if name == "fish" else dry()


def under_water(steps: tuple[int, ...], name: str = "fish") -> Figures:
    """Measure rise and speed of the head after given numbers of steps without torque."""
    body, engine = embodied(name, deep())
    start(engine, deep(), np.random.default_rng(0))
    return _course(engine, body, steps)


def released(name: str) -> Figures:
    """Measure `under_water` for a body released in open water at rest, climbers from the ceiling."""
    body = load_embodiment(name)
    engine = PymunkEngine(body, parkour_rules(body))  # unlike our own engine, lets parts be moved
    start(engine, deep(), np.random.default_rng(0))
    if name not in CLIMBERS:
        for part in engine._parts:
            part.position += (0.0, RELEASE_HEIGHT)
            part.velocity, part.angular_velocity = (0.0, 0.0), 0.0
        engine.state[:, 1] += RELEASE_HEIGHT
    return _course(engine, body, RELEASE_STEPS)


def hanging(name: str, grip: float, motors: float = 0.0, count: int = 20) -> Figures:
    """Measure a climber after 100 steps with grip action `grip` and random actions of its `motors`."""
    body, engine, rows = *embodied(name, dry()), []
    for seed in range(count):
        rng = np.random.default_rng([seed, 4])
        start(engine, dry(), rng)
        begin, action = engine.state[body.head, 0], np.full(body.action_size, grip)
        ended = []
        for step in range(1, 101):
            action[: len(body.motors)] = motors * rng.uniform(-1, 1, len(body.motors))
            ended += [step] if engine.step(action)[2] else []
        x, y = engine.state[body.head, :2]
        held = np.all(engine.grips[:, 1] != NOTHING)
        rows.append((held, bool(ended), ended[0] if ended else 101, dry().ceiling[0, 1] - y, x - begin))
    names = (
        *("still_attached_by_both_hands_after_100", "fraction_terminated", "first_terminal_step"),
        *("head_distance_below_ceiling", "head_x_displacement"),
    )
    return dict(zip(names, np.array(rows).T.astype(float), strict=True))


def random_actions(name: str, count: int) -> Figures:
    """Measure `count` episodes of uniform random actions, truncated at 500 steps."""
    return episodes(place_of(name), count, 500, name)


def _course(engine: Engine, body: Embodiment, steps: tuple[int, ...]) -> Figures:
    begin, courses = engine.state[body.head, 1], []
    for _ in range(max(steps)):
        engine.step(np.zeros(body.action_size))
        courses.append((engine.state[body.head, 1] - begin, engine.state[body.head, 4]))
    rises, speeds = np.array(courses)[np.array(steps) - 1].T
    return {"rise": rises, "speed": speeds}


def table() -> Iterator[str]:
    """Yield rows of Markdown tables of the release's means against ours."""
    protocols = {
        "zero_actions": lambda name: zero_action(name, 20, dry()),
        "random_actions": lambda name: random_actions(name, 100),
        "random_gaits": lambda name: gaits(name, 100, place_of(name)),
    }
    for protocol, measure in protocols.items():
        for name in BODIES:
            yield f"| {protocol} | {name} | {cells(measured(protocol, 'parkour', name), measure(name))} |"
    for name in CLIMBERS:
        cases = (("no grip", 0.0, 0.0), ("grip", 1.0, 0.0), ("grip and random motors", 1.0, 1.0))
        for case, grip, motors in cases:
            release = measured("hanging", "parkour", name, case)
            yield f"| {case} | {name} | {cells(release, hanging(name, grip, motors))} |"
    yield from _table_of_water()


def _table_of_water() -> Iterator[str]:
    for name in RELEASED:
        ours = released(name)
        for index, steps in enumerate(RELEASE_STEPS):
            release = measured("released_in_water", "parkour", name, f"after {steps} steps")
            pairs = [f"{theirs.mean:.3f} / {ours[figure][index]:.3f}" for figure, theirs in release.items()]
            yield f"| released in water | {name} | {steps} | {' | '.join(pairs)} |"
    under = under_water(FISH_STEPS)
    yield f"| fish under water | {under['rise'].round(3).tolist()} | {under['speed'].round(3).tolist()} |"


if __name__ == "__main__":
    sys.stdout.writelines(f"{row}\n" for row in table())

"""Bodies with other numbers of legs, sizes and torques than their files."""

from pathlib import Path

import numpy as np
import pytest

import tma_ray.embodiments
from tma_ray.embodiments import EmbodimentError, embodiment_names, load_embodiment

DATA = Path(tma_ray.embodiments.__file__).parent / "data"


@pytest.mark.parametrize("pairs", [1, 2, 3, 8])
def test_a_spider_has_two_legs_a_pair(pairs: int) -> None:
    body = load_embodiment("spider", pairs_of_legs=pairs)
    assert body.name == ("spider" if pairs == 2 else f"spider:pairs_of_legs={pairs}")  # two are its own
    assert body.action_size == 6 * pairs
    lower = [f"lower_leg_{leg}" for leg in range(1, 2 * pairs + 1)]
    assert [joint.contact_part for joint in body.motors if joint.contact_part] == lower


@pytest.mark.parametrize("bodies", [1, 2, 4, 7, 12])
def test_a_millipede_is_a_chain_with_its_head_in_front(bodies: int) -> None:
    body = load_embodiment("millipede", bodies=bodies)
    assert body.action_size == 4 * bodies
    assert len(body.passive_joints) == bodies - 1
    trunk = [part for part in body.parts if part.name.startswith("body_")]
    xs = [part.position[0] for part in trunk]
    assert np.diff(xs) == pytest.approx(2 / 3)
    assert np.mean(xs) == pytest.approx(-1 / 3)
    assert [part.head for part in trunk] == [False] * (bodies - 1) + [True]
    for joint, left, right in zip(body.passive_joints, trunk[:-1], trunk[1:], strict=True):
        assert (joint.part_a, joint.part_b) == (left.name, right.name)
        assert joint.anchor[0] == pytest.approx((left.position[0] + right.position[0]) / 2)


@pytest.mark.parametrize("name", embodiment_names())
def test_size_is_a_factor_of_lengths_and_torque_is_absolute(name: str) -> None:
    body, large = load_embodiment(name), load_embodiment(name, size=2, motor_torque=50)
    assert large.name == f"{name}:motor_torque=50:size=2"
    assert large.spawn_height == 2 * body.spawn_height
    for part, twice in zip(body.parts, large.parts, strict=True):
        assert twice.mass == pytest.approx(4 * part.mass)
        assert twice.inertia == pytest.approx(16 * part.inertia)
        assert twice.position == pytest.approx([2 * value for value in part.position])
    for joint, twice in zip(body.joints, large.joints, strict=True):
        assert np.array(twice.anchors) == pytest.approx(2 * np.array(joint.anchors))
        assert twice.motor_torque == (0 if joint.passive else 50)
    for sensor, twice in zip(body.grip_sensors, large.grip_sensors, strict=True):
        assert twice.position == pytest.approx([2 * value for value in sensor.position])
        assert (twice.radius, twice.mass) == pytest.approx((2 * sensor.radius, 4 * sensor.mass))


def test_any_body_may_drown_or_suffocate_after_other_times() -> None:
    fish = load_embodiment("fish:steps_survivable_under_water=5:steps_survivable_outside_water=0")
    assert (fish.steps_survivable_under_water, fish.steps_survivable_outside_water) == (5, 0)
    assert load_embodiment(fish.name) == fish
    biped = load_embodiment("classic_bipedal", steps_survivable_outside_water=100)
    assert (biped.steps_survivable_under_water, biped.steps_survivable_outside_water) == (600, 100)


def test_a_repeated_section_may_hold_grip_sensors(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    sensor = '[[repeat.grip_sensors]]\nname = "grip_{k}"\npart = "lower_leg_{2k}"\nposition = [1.447, -0.37]'
    path.write_text((DATA / "spider.toml").read_text() + sensor)
    body = load_embodiment(path, pairs_of_legs=3)
    expected = [(f"grip_{pair}", f"lower_leg_{2 * pair}") for pair in (1, 2, 3)]
    assert [(grip.name, grip.part) for grip in body.grip_sensors] == expected
    assert body.action_size == 21


def test_a_name_may_hold_the_parameters() -> None:
    expected = load_embodiment("spider", pairs_of_legs=3, size=1.5)
    assert load_embodiment("spider:pairs_of_legs=3:size=1.5") == expected
    assert load_embodiment(expected.name) == expected
    path = f"{DATA / 'spider.toml'}:pairs_of_legs=3:size=1.5"
    assert load_embodiment(path) == expected


OUTSIDE = "steps_survivable_outside_water"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("spider:legs=3", "unknown parameter 'legs': known: pairs_of_legs, size, motor_torque"),
        ("spider:pairs_of_legs=0", "pairs_of_legs 0 must be a whole number from 1 to 8"),
        ("spider:pairs_of_legs=2.5", "pairs_of_legs 2.5 must be a whole number"),
        ("spider:pairs_of_legs=many", "pairs_of_legs=many: expected a number"),
        ("classic_bipedal:bodies=3", "unknown parameter 'bodies': known: size, motor_torque"),
        (f"fish:{OUTSIDE}=-1", f"{OUTSIDE} -1.0 must be a whole number"),
        (f"fish:{OUTSIDE}=2.5", f"{OUTSIDE} 2.5 must be a whole number"),
        ("wheel:size=0", "size = 0: expected a number over 0"),
        ("wheel:motor_torque=inf", "motor_torque = inf: expected a number of N m over 0"),
        ("spidr:size=2", "did you mean 'spider'"),
    ],
)
def test_parameters_that_make_no_body_are_refused(name: str, message: str) -> None:
    with pytest.raises(EmbodimentError, match=message):
        load_embodiment(name)

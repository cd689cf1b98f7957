"""Every number of every body against the measured bodies of the original release."""

import json
from pathlib import Path
from typing import Any

import pytest

from tma_ray.embodiments import Embodiment, LidarLayout, embodiment_names, load_embodiment
from tma_ray.physics import Rules, observation_size
from tma_ray.physics.rules import body_arrays, step_arrays

BODIES: dict[str, Any] = json.loads((Path(__file__).parents[1] / "reference" / "bodies.json").read_text())
TOLERANCE = {"rel": 0.01, "abs": 1e-5}

CHOSEN_LIDARS = {"amphibious_bipedal": LidarLayout.FULL}
"""Lidars of bodies whose lidars the release leaves open."""

OLD = ("old_classic_bipedal", "old_quadrupedal")
"""Bodies that the release starts at another height in Parkour; ours start as in Stump Tracks."""


def test_every_shipped_body_is_measured() -> None:
    assert list(BODIES) == sorted(embodiment_names())


@pytest.mark.parametrize("name", BODIES)
def test_whole_body(name: str) -> None:
    body, measured = load_embodiment(name), BODIES[name]
    assert body.name == name
    assert body.body_type == measured["body_type"]
    assert body.torque_cost == pytest.approx(measured["torque_cost"], **TOLERANCE)
    assert body.upright_reward == measured["upright_reward"]
    pieces = (*body.parts, *body.grip_sensors)
    assert sum(piece.mass for piece in pieces) == pytest.approx(measured["total_mass"], **TOLERANCE)
    assert body.lidars == (measured["lidars"] or CHOSEN_LIDARS[name])
    assert body.steps_survivable_under_water == measured["steps_survivable_under_water"]
    assert body.steps_survivable_outside_water == measured["steps_survivable_outside_water"]
    assert body.may_touch_ceiling == bool(body.grip_sensors) == (measured["body_type"] == "climber")
    assert body.pushed == measured["pushed"]


@pytest.mark.parametrize("environment", ["stump_tracks", "parkour"])
@pytest.mark.parametrize("name", BODIES)
def test_start_and_sizes(name: str, environment: str) -> None:
    body, measured = load_embodiment(name), BODIES[name]
    assert body.action_size == measured["action_size"][environment]
    rules = Rules(environment, body.lidars, observes_medium=environment == "parkour")
    assert observation_size(step_arrays(body, rules)) == measured["observation_size"][environment]
    if environment == "stump_tracks" or name not in OLD:
        assert body.spawn_height == pytest.approx(measured["spawn_height"][environment], **TOLERANCE)


@pytest.mark.parametrize("name", BODIES)
def test_parts(name: str) -> None:
    parts, entries = load_embodiment(name).parts, BODIES[name]["parts"]
    assert [part.name for part in parts] == [entry["name"] for entry in entries]
    for part, entry in zip(parts, entries, strict=True):
        assert part.head == entry["head"]
        assert list(part.critical) == entry["critical"]
        for field in ("angle", "position", "density", "friction", "mass", "inertia"):
            assert getattr(part, field) == pytest.approx(entry[field], **TOLERANCE), field
        assert part.shape.centroid == pytest.approx(entry["centroid"], **TOLERANCE)
        assert _rotated(part.shape.vertices) == _rotated(entry["vertices"])


@pytest.mark.parametrize("name", BODIES)
def test_grip_sensors(name: str) -> None:
    body, entries = load_embodiment(name), BODIES[name]["grip_sensors"]
    assert [sensor.name for sensor in body.grip_sensors] == [entry["name"] for entry in entries]
    for sensor, entry in zip(body.grip_sensors, entries, strict=True):
        assert sensor.part == entry["part"]
        part = body.parts[body.part_index(sensor.part)]
        assert part.local(sensor.position) == pytest.approx(entry["local_anchor"], **TOLERANCE)
        for field in ("position", "radius", "density", "mass"):
            assert getattr(sensor, field) == pytest.approx(entry[field], **TOLERANCE), field
        assert sensor.inertia == pytest.approx(entry["inertia"], rel=0.01, abs=1e-7)


@pytest.mark.parametrize("name", BODIES)
def test_joints(name: str) -> None:
    body, measured = load_embodiment(name), BODIES[name]
    arrays = body_arrays(body)
    joints = (*body.motors, *body.passive_joints)
    passive = measured["passive_joints"][::-1]  # ours from the rear, the release's from the head
    assert len(body.motors) == len(measured["motors"])
    for index, (joint, entry) in enumerate(zip(joints, measured["motors"] + passive, strict=True)):
        assert [joint.part_a, joint.part_b] == entry["parts"]
        for ours, key in ((joint.anchors, "anchors"), (arrays.anchors[index], "local_anchors")):
            assert ours[0] == pytest.approx(entry[key][0], **TOLERANCE)
            assert ours[1] == pytest.approx(entry[key][1], **TOLERANCE)
        assert joint.limits == pytest.approx(tuple(entry["limits"]), **TOLERANCE)
        turned = arrays.limits[index] - joint.limits
        assert turned == pytest.approx(2 * [entry["reference_angle"]], **TOLERANCE)
        assert joint.motor_torque == pytest.approx(entry["torque"], **TOLERANCE)
        assert joint.motor_speed == pytest.approx(entry["speed"], **TOLERANCE)
        assert joint.angle_offset == pytest.approx(entry["angle_offset"], **TOLERANCE)
        assert joint.contact_part == entry["contact_part"]


@pytest.mark.parametrize("name", BODIES)
def test_observation_layout(name: str) -> None:
    body: Embodiment = load_embodiment(name)
    ours = []
    for index, joint in enumerate(body.motors):
        label = f"joint {index} ({joint.part_a} -> {joint.part_b})"
        ours += [f"{label} angle", f"{label} speed"]
        ours += [f"{label} contact of {joint.contact_part}"] if joint.contact_part else []
    for index in range(len(body.grip_sensors)):
        label = f"grip sensor {index}"
        ours += [f"{label} touches a graspable surface", f"{label} is attached"]
    assert ours == BODIES[name]["observed_joints_and_grips"]


def _rotated(vertices: Any) -> list[tuple[float, float]]:
    """Return corners from the lowest leftmost one on: where an outline begins does not matter."""
    points = [(round(float(x), 5), round(float(y), 5)) for x, y in vertices]
    first = points.index(min(points))
    return points[first:] + points[:first]

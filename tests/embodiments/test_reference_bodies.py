"""Every number of every body against the measured bodies of the original release."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from tma_ray.embodiments import Embodiment, LidarLayout, embodiment_names, load_embodiment
from tma_ray.physics import Rules, observation_size
from tma_ray.physics.arrays import body_arrays
from tma_ray.physics.rules import step_arrays

sys.path.insert(0, str(Path(__file__).parents[1] / "physics"))

from behaviour import RELEASE_NAMES

pytestmark = pytest.mark.reference
TOLERANCE = {"rel": 0.01, "abs": 1e-5}

CHOSEN_LIDARS = {"amphibious_bipedal": LidarLayout.FULL}
"""Lidars of bodies whose lidars the release leaves open."""

OLD = ("old_classic_bipedal", "old_quadrupedal")
"""Bodies that the release starts at another height in Parkour; ours start as in Stump Tracks."""


@pytest.fixture(scope="module")
def folder() -> Path:
    if "TMA_REFERENCE" not in os.environ:
        pytest.skip("TMA_REFERENCE is not set: no measured bodies to compare with")
    return Path(os.environ["TMA_REFERENCE"])


@pytest.fixture(scope="module")
def bodies(folder: Path) -> dict[str, Any]:
    measured = json.loads((folder / "embodiments.json").read_text())
    return {name: measured[RELEASE_NAMES.get(name, name)] for name in embodiment_names()}


@pytest.mark.parametrize("name", embodiment_names())
def test_whole_body(name: str, bodies: dict[str, Any]) -> None:
    body, measured = load_embodiment(name), bodies[name]
    assert body.body_type == measured["body_type"]
    assert body.torque_cost == pytest.approx(measured["torque_cost_per_unit_action"], **TOLERANCE)
    assert body.upright_reward == (not measured["head_angle_reward_removed"])
    assert len(body.motors) == measured["number_of_motors"]
    assert len(body.grip_sensors) == measured["number_of_grip_sensors"]
    assert len(body.joints) + len(body.grip_sensors) == len(measured["joints"])
    pieces = (*body.parts, *body.grip_sensors)
    assert sum(piece.mass for piece in pieces) == pytest.approx(measured["total_mass"], **TOLERANCE)


@pytest.mark.parametrize("environment", ["stump_tracks", "parkour"])
@pytest.mark.parametrize("name", embodiment_names())
def test_start_and_actions(name: str, environment: str, bodies: dict[str, Any]) -> None:
    body, measured = load_embodiment(name), bodies[name]["environments"][environment]
    assert body.action_size == measured["action_size"]
    if environment == "stump_tracks" or name not in OLD:
        height = measured["spawn"]["spawn_y_above_ground"]
        assert body.spawn_height == pytest.approx(height, **TOLERANCE)


@pytest.mark.parametrize("name", embodiment_names())
def test_life_in_parkour(name: str, bodies: dict[str, Any], folder: Path) -> None:
    body, measured = load_embodiment(name), bodies[name]
    rules = json.loads((folder / "environments.json").read_text())["parkour"]
    assert body.lidars == (measured["default_parkour_lidar"] or CHOSEN_LIDARS[name])
    assert body.steps_survivable_under_water == measured["steps_survivable_under_water"]
    assert body.steps_survivable_outside_water == measured["steps_survivable_outside_water"]
    assert body.may_touch_ceiling == body.hangs == (measured["body_type"] == "climber")
    assert body.pushed == (name not in rules["spawn"]["initial_random_force"]["bodies_without_it"])


@pytest.mark.parametrize("name", embodiment_names())
def test_parts(name: str, bodies: dict[str, Any]) -> None:
    body, measured = load_embodiment(name), bodies[name]
    entries = [entry for entry in measured["parts"] if entry["kind"] != "grip_sensor"]
    assert [part.name for part in body.parts] == [entry["id"] for entry in entries]
    for part, entry in zip(body.parts, entries, strict=True):
        assert part.head == entry["is_head"]
        assert part.critical == tuple(env for env, value in entry["contact_is_critical"].items() if value)
        assert part.angle == pytest.approx(entry["angle"], **TOLERANCE)
        assert entry["restitution"] == 0, "our parts do not bounce"
        assert part.position == pytest.approx(entry["position"], **TOLERANCE)
        assert part.density == pytest.approx(entry["density"], **TOLERANCE)
        assert part.friction == pytest.approx(entry["friction"], **TOLERANCE)
        assert part.mass == pytest.approx(entry["mass"], **TOLERANCE)
        assert part.inertia == pytest.approx(entry["inertia_about_centre_of_mass"], **TOLERANCE)
        assert part.shape.centroid == pytest.approx(entry["local_centre"], **TOLERANCE)
        assert _rotated(part.shape.vertices) == _rotated(entry["shape"]["vertices"])


@pytest.mark.parametrize("name", embodiment_names())
def test_grip_sensors(name: str, bodies: dict[str, Any]) -> None:
    body, measured = load_embodiment(name), bodies[name]
    entries = [entry for entry in measured["parts"] if entry["kind"] == "grip_sensor"]
    welds = {joint["part_b"]: joint for joint in measured["joints"] if joint["type"] == "weld"}
    assert [sensor.name for sensor in body.grip_sensors] == [entry["id"] for entry in entries]
    for sensor, entry in zip(body.grip_sensors, entries, strict=True):
        assert sensor.part == welds[sensor.name]["part_a"]
        part = body.parts[body.part_index(sensor.part)]
        assert part.local(sensor.position) == pytest.approx(welds[sensor.name]["local_anchor_a"], **TOLERANCE)
        assert sensor.position == pytest.approx(entry["position"], **TOLERANCE)
        assert entry["is_sensor"], "ours collide with nothing"
        assert entry["shape"]["kind"] == "circle"
        assert entry["shape"]["centre"] == [0, 0]
        assert sensor.radius == pytest.approx(entry["shape"]["radius"], **TOLERANCE)
        assert sensor.density == pytest.approx(entry["density"], **TOLERANCE)
        assert sensor.mass == pytest.approx(entry["mass"], **TOLERANCE)
        inertia = entry["inertia_about_centre_of_mass"]
        assert sensor.inertia == pytest.approx(inertia, rel=0.01, abs=1e-7)


@pytest.mark.parametrize("name", embodiment_names())
def test_joints(name: str, bodies: dict[str, Any]) -> None:
    body, measured = load_embodiment(name), bodies[name]
    arrays = body_arrays(body)
    entries = _in_our_order(measured["joints"])
    for index, (joint, entry) in enumerate(zip((*body.motors, *body.passive_joints), entries, strict=True)):
        assert (joint.part_a, joint.part_b) == (entry["part_a"], entry["part_b"])
        assert joint.passive == (not entry["motor_enabled"])
        assert joint.anchors[0] == pytest.approx(entry["anchor_from_a"], **TOLERANCE)
        assert joint.anchors[1] == pytest.approx(entry["anchor_from_b"], **TOLERANCE)
        assert arrays.anchors[index, 0] == pytest.approx(entry["local_anchor_a"], **TOLERANCE)
        assert arrays.anchors[index, 1] == pytest.approx(entry["local_anchor_b"], **TOLERANCE)
        assert joint.limits == pytest.approx((entry["lower_limit"], entry["upper_limit"]), **TOLERANCE)
        turned = arrays.limits[index] - joint.limits
        assert turned == pytest.approx(2 * [entry["reference_angle"]], **TOLERANCE)
        assert joint.motor_torque == pytest.approx(entry["max_motor_torque"], **TOLERANCE)
        assert joint.motor_speed == pytest.approx(entry.get("speed_scale") or 0, **TOLERANCE)
        assert joint.angle_offset == pytest.approx(entry.get("angle_correction") or 0, **TOLERANCE)
        assert joint.contact_part == (entry["contact_part"] if entry.get("reports_contact") else None)


@pytest.mark.parametrize(("environment", "values_of_the_head"), [("stump_tracks", 4), ("parkour", 6)])
@pytest.mark.parametrize("name", embodiment_names())
def test_observation_layout(
    name: str, environment: str, values_of_the_head: int, bodies: dict[str, Any]
) -> None:
    body: Embodiment = load_embodiment(name)
    layout = bodies[name]["environments"][environment]["observation_layout"]
    meanings = [entry["meaning"] for entry in layout]
    lidars = meanings.index("lidar distances")
    ours = []
    for index, joint in enumerate(body.motors):
        label = f"joint {index} ({joint.part_a} -> {joint.part_b})"
        ours += [f"{label} angle", f"{label} speed"]
        ours += [f"{label} contact of {joint.contact_part}"] if joint.contact_part else []
    for index in range(len(body.grip_sensors)):
        label = f"grip sensor {index}"
        ours += [f"{label} touches a graspable surface", f"{label} is attached"]
    assert ours == meanings[values_of_the_head:lidars]


@pytest.mark.parametrize("environment", ["stump_tracks", "parkour"])
@pytest.mark.parametrize("name", embodiment_names())
def test_observation_size(name: str, environment: str, bodies: dict[str, Any]) -> None:
    body = load_embodiment(name)
    rules = Rules(environment, body.lidars, observes_milieu=environment == "parkour")
    measured = bodies[name]["environments"][environment]
    assert observation_size(step_arrays(body, rules)) == measured["observation_size"]


def _in_our_order(joints: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Returns motors as they come, then passive joints from the rear: the release's begin at the head."""
    hinges = [entry for entry in joints if entry["type"] == "revolute"]
    passive = [entry for entry in hinges if not entry["motor_enabled"]]
    return [entry for entry in hinges if entry["motor_enabled"]] + passive[::-1]


def _rotated(vertices: Any) -> list[tuple[float, float]]:
    """Returns corners from the lowest leftmost one on: where an outline begins does not matter."""
    points = [(round(float(x), 5), round(float(y), 5)) for x, y in vertices]
    first = points.index(min(points))
    return points[first:] + points[:first]

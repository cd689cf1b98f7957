"""Every number of every body against the measured bodies of the original release."""

import json
import os
from pathlib import Path
from typing import Any

import pytest

from tma_ray.embodiments import Embodiment, embodiment_names, load_embodiment
from tma_ray.envs.stump_tracks import RULES
from tma_ray.physics import observation_size
from tma_ray.physics.arrays import body_arrays
from tma_ray.physics.rules import step_arrays

pytestmark = pytest.mark.reference
TOLERANCE = {"rel": 0.01, "abs": 1e-5}

RELEASE_NAMES = {
    "short_bipedal": "small_bipedal",
    "quadrupedal": "big_quadru",
    "walking_chimpanzee": "profile_chimpanzee",
    "old_quadrupedal": "old_big_quadru",
}
"""Names of the release that differ from ours."""


@pytest.fixture(scope="module")
def bodies() -> dict[str, Any]:
    folder = os.environ.get("TMA_REFERENCE")
    if folder is None:
        pytest.skip("TMA_REFERENCE is not set: no measured bodies to compare with")
    measured = json.loads((Path(folder) / "embodiments.json").read_text())
    return {name: measured[RELEASE_NAMES.get(name, name)] for name in embodiment_names()}


@pytest.mark.parametrize("name", embodiment_names())
def test_whole_body(name: str, bodies: dict[str, Any]) -> None:
    body, measured = load_embodiment(name), bodies[name]
    assert body.body_type == measured["body_type"]
    assert body.torque_cost == pytest.approx(measured["torque_cost_per_unit_action"], **TOLERANCE)
    assert body.upright_reward == (not measured["head_angle_reward_removed"])
    assert body.action_size == measured["number_of_motors"]
    assert len(body.joints) == len(measured["joints"])
    assert sum(part.mass for part in body.parts) == pytest.approx(measured["total_mass"], **TOLERANCE)
    spawn = measured["environments"]["stump_tracks"]["spawn"]["spawn_y_above_ground"]
    assert body.spawn_height == pytest.approx(spawn, **TOLERANCE)


@pytest.mark.parametrize("name", embodiment_names())
def test_parts(name: str, bodies: dict[str, Any]) -> None:
    body, measured = load_embodiment(name), bodies[name]
    assert [part.name for part in body.parts] == [entry["id"] for entry in measured["parts"]]
    for part, entry in zip(body.parts, measured["parts"], strict=True):
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


@pytest.mark.parametrize("name", embodiment_names())
def test_observation_layout(name: str, bodies: dict[str, Any]) -> None:
    body: Embodiment = load_embodiment(name)
    measured = bodies[name]["environments"]["stump_tracks"]
    expected = [entry["meaning"] for entry in measured["observation_layout"][4:-1]]
    assert observation_size(step_arrays(body, RULES)) == measured["observation_size"]
    ours = []
    for index, joint in enumerate(body.motors):
        label = f"joint {index} ({joint.part_a} -> {joint.part_b})"
        ours += [f"{label} angle", f"{label} speed"]
        ours += [f"{label} contact of {joint.contact_part}"] if joint.contact_part else []
    assert ours == expected


def _in_our_order(joints: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Returns motors as they come, then passive joints from the rear: the release's begin at the head."""
    passive = [entry for entry in joints if not entry["motor_enabled"]]
    return [entry for entry in joints if entry["motor_enabled"]] + passive[::-1]


def _rotated(vertices: Any) -> list[tuple[float, float]]:
    """Returns corners from the lowest leftmost one on: where an outline begins does not matter."""
    points = [(round(float(x), 5), round(float(y), 5)) for x, y in vertices]
    first = points.index(min(points))
    return points[first:] + points[:first]

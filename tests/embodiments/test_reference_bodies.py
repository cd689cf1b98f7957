"""Every number of every body against the measured bodies of the original release."""

import json
import os
from pathlib import Path
from typing import Any

import pytest

from tma_ray.embodiments import Embodiment, embodiment_names, load_embodiment
from tma_ray.physics.arrays import body_arrays

pytestmark = pytest.mark.reference
TOLERANCE = {"rel": 0.01, "abs": 1e-5}


@pytest.fixture(scope="module")
def bodies() -> dict[str, Any]:
    folder = os.environ.get("TMA_REFERENCE")
    if folder is None:
        pytest.skip("TMA_REFERENCE is not set: no measured bodies to compare with")
    return json.loads((Path(folder) / "embodiments.json").read_text())


@pytest.mark.parametrize("name", embodiment_names())
def test_whole_body(name: str, bodies: dict[str, Any]) -> None:
    body, measured = load_embodiment(name), bodies[name]
    assert body.body_type == measured["body_type"]
    assert body.torque_cost == pytest.approx(measured["torque_cost_per_unit_action"], **TOLERANCE)
    assert body.upright_reward == (not measured["head_angle_reward_removed"])
    assert body.action_size == measured["number_of_motors"]
    assert sum(part.mass for part in body.parts) == pytest.approx(measured["total_mass"], **TOLERANCE)
    spawn = measured["environments"]["stump_tracks"]["spawn"]["spawn_y_above_ground"]
    assert body.spawn_height == pytest.approx(spawn, **TOLERANCE)


@pytest.mark.parametrize("name", embodiment_names())
def test_parts(name: str, bodies: dict[str, Any]) -> None:
    body, measured = load_embodiment(name), bodies[name]
    assert [part.name for part in body.parts] == [entry["id"] for entry in measured["parts"]]
    for part, entry in zip(body.parts, measured["parts"], strict=True):
        assert part.head == entry["is_head"]
        assert part.critical == entry["contact_is_critical"]["stump_tracks"]
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
    anchors = body_arrays(body).anchors
    for joint, local, entry in zip(body.joints, anchors, measured["joints"], strict=True):
        assert (joint.part_a, joint.part_b) == (entry["part_a"], entry["part_b"])
        assert joint.anchor == pytest.approx(entry["anchor_from_a"], **TOLERANCE)
        assert local[0] == pytest.approx(entry["local_anchor_a"], **TOLERANCE)
        assert local[1] == pytest.approx(entry["local_anchor_b"], **TOLERANCE)
        assert joint.limits == pytest.approx((entry["lower_limit"], entry["upper_limit"]), **TOLERANCE)
        assert joint.motor_torque == pytest.approx(entry["max_motor_torque"], **TOLERANCE)
        assert joint.motor_speed == pytest.approx(entry["speed_scale"], **TOLERANCE)
        assert joint.angle_offset == pytest.approx(entry["angle_correction"], **TOLERANCE)
        assert joint.contact_part == (entry["contact_part"] if entry["reports_contact"] else None)


@pytest.mark.parametrize("name", embodiment_names())
def test_observation_layout(name: str, bodies: dict[str, Any]) -> None:
    body: Embodiment = load_embodiment(name)
    layout = bodies[name]["environments"]["stump_tracks"]["observation_layout"]
    expected = [entry["meaning"] for entry in layout[4:-1]]
    ours = []
    for index, joint in enumerate(body.joints):
        label = f"joint {index} ({joint.part_a} -> {joint.part_b})"
        ours += [f"{label} angle", f"{label} speed"]
        ours += [f"{label} contact of {joint.contact_part}"] if joint.contact_part else []
    assert ours == expected


def _rotated(vertices: Any) -> list[tuple[float, float]]:
    """Returns corners from the lowest leftmost one on: where an outline begins does not matter."""
    points = [(round(float(x), 5), round(float(y), 5)) for x, y in vertices]
    first = points.index(min(points))
    return points[first:] + points[:first]

"""Checks of the parts, joints and grip sensors of a body, before it is built."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from tma_ray.embodiments.parts import GripSensor, Joint, Part
from tma_ray.embodiments.polygon import Point

ANCHOR_TOLERANCE = 0.02
"""How far outside its parts a joint may be anchored, in m: drawings round to the pixel."""


class EmbodimentError(ValueError):
    """A body that cannot be built; the message names the body and the part or joint at fault."""


def check_structure(
    parts: Sequence[Part], joints: Sequence[Joint], grip_sensors: Sequence[GripSensor]
) -> None:
    """Checks that parts, joints and grip sensors make one connected body.

    Raises:
        ValueError: they do not; the message names the part, joint or sensor at fault.
    """
    _check_parts(parts, grip_sensors)
    named = {part.name: part for part in parts}
    for index, joint in enumerate(joints):
        _check_joint(f"joint {index} ({joint.part_a} to {joint.part_b})", joint, named)
    for sensor in grip_sensors:
        _check_grip_sensor(f"grip sensor {sensor.name!r}", sensor, named)
    _check_connected(parts, joints)


def _check_parts(parts: Sequence[Part], grip_sensors: Sequence[GripSensor]) -> None:
    counts = Counter([part.name for part in parts] + [sensor.name for sensor in grip_sensors])
    repeated = [name for name, count in counts.items() if count > 1]
    if repeated:
        raise ValueError(f"part name {repeated[0]!r} is used more than once; names must differ")
    heads = [part.name for part in parts if part.head]
    if len(heads) != 1:
        raise ValueError(f"exactly one part must have head = true, got {heads or 'none'}")
    for part in parts:
        if not part.density > 0:
            raise ValueError(f"part {part.name!r}: density {part.density} kg/m² must be over 0")
        if not part.friction >= 0:
            raise ValueError(f"part {part.name!r}: friction {part.friction} must not be negative")


def _check_joint(where: str, joint: Joint, parts: dict[str, Part]) -> None:
    for name in (joint.part_a, joint.part_b, joint.contact_part):
        if name is not None:
            _check_known(where, name, parts)
    if joint.part_a == joint.part_b:
        raise ValueError(f"{where}: a joint needs two different parts")
    if not joint.limits[0] < joint.limits[1]:
        raise ValueError(f"{where}: limits {list(joint.limits)} must rise")
    _check_motor(where, joint)
    for name, anchor in zip((joint.part_a, joint.part_b), joint.anchors, strict=True):
        distance = _distance(parts[name], anchor)
        if not (distance <= ANCHOR_TOLERANCE or joint.outside_parts):
            raise ValueError(
                f"{where}: anchor {list(anchor)} lies {distance:.3f} m outside part {name!r}; it must "
                f"lie in both parts, unless outside_parts = true or an anchor_b of its own say otherwise"
            )


def _check_motor(where: str, joint: Joint) -> None:
    if joint.passive:
        if joint.contact_part is not None or joint.angle_offset != 0:
            raise ValueError(f"{where}: a joint without motor is not observed: it has no contact_part")
    elif not (joint.motor_torque > 0 and joint.motor_speed > 0):
        raise ValueError(
            f"{where}: motor_torque {joint.motor_torque} N m and motor_speed {joint.motor_speed} rad/s "
            f"must be over 0, or both be left out in a joint without motor"
        )


def _check_grip_sensor(where: str, sensor: GripSensor, parts: dict[str, Part]) -> None:
    _check_known(where, sensor.part, parts)
    if not (sensor.radius > 0 and sensor.density > 0):
        raise ValueError(
            f"{where}: radius {sensor.radius} m and density {sensor.density} kg/m² must be over 0"
        )
    distance = _distance(parts[sensor.part], sensor.position)
    if not distance <= sensor.radius + ANCHOR_TOLERANCE:
        raise ValueError(
            f"{where}: position {list(sensor.position)} lies {distance:.3f} m outside part {sensor.part!r}; "
            f"the circle of radius {sensor.radius} m must touch it"
        )


def _check_known(where: str, name: str, parts: dict[str, Part]) -> None:
    if name not in parts:
        raise ValueError(f"{where}: no part {name!r}; the parts are {', '.join(parts)}")


def _distance(part: Part, point: Point) -> float:
    """Returns how far `point`, relative to the spawn point, lies outside `part`, in m."""
    return part.shape.distance(part.local(point))


def _check_connected(parts: Sequence[Part], joints: Sequence[Joint]) -> None:
    reached = {part.name for part in parts if part.head}
    for _ in parts:
        for joint in joints:
            if reached & {joint.part_a, joint.part_b}:
                reached |= {joint.part_a, joint.part_b}
    loose = [part.name for part in parts if part.name not in reached]
    if loose:
        raise ValueError(f"no joint connects part {loose[0]!r} to the head")

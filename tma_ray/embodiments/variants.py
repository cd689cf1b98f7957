"""Bodies with other proportions or motors, derived from those in the files."""

from __future__ import annotations

from dataclasses import replace

from tma_ray.commands.quantities import BODY_SIZE, TORQUE
from tma_ray.embodiments.embodiment import Embodiment
from tma_ray.embodiments.parts import GripSensor, Joint, Part
from tma_ray.embodiments.polygon import Point, Polygon
from tma_ray.part_names import split_name


def body_parameters(text: str) -> tuple[str, dict[str, float]]:
    """Returns a body's name or path without its parameters, and the parameters.

    Raises:
        ValueError: a parameter that is not a number, or is given twice.

    Examples:
        >>> body_parameters("spider:pairs_of_legs=3:size=1.2")
        ('spider', {'pairs_of_legs': 3, 'size': 1.2})
    """
    name, settings = split_name(text)
    return name, {key: _number(key, value) for key, value in settings.items()}


def resized(body: Embodiment, size: float) -> Embodiment:
    """Returns `body` with all lengths multiplied by `size`; densities and torques stay.

    Raises:
        ValueError: a size that is not over 0, or absurd.
    """
    BODY_SIZE.check("size", size)
    return replace(
        body,
        spawn_height=body.spawn_height * size,
        parts=tuple(_resized_part(part, size) for part in body.parts),
        joints=tuple(_resized_joint(joint, size) for joint in body.joints),
        grip_sensors=tuple(_resized_grip_sensor(sensor, size) for sensor in body.grip_sensors),
    )


def with_motor_torque(body: Embodiment, torque: float) -> Embodiment:
    """Returns `body` with the largest torque of every motor set to `torque` N m.

    Raises:
        ValueError: a torque that is not over 0, or absurd.
    """
    TORQUE.check("motor_torque", torque)
    joints = [joint if joint.passive else replace(joint, motor_torque=float(torque)) for joint in body.joints]
    return replace(body, joints=tuple(joints))


def _resized_part(part: Part, size: float) -> Part:
    shape = Polygon(tuple(_times(corner, size) for corner in part.shape.vertices))
    return replace(part, shape=shape, position=_times(part.position, size))


def _resized_joint(joint: Joint, size: float) -> Joint:
    anchor_b = None if joint.anchor_b is None else _times(joint.anchor_b, size)
    return replace(joint, anchor=_times(joint.anchor, size), anchor_b=anchor_b)


def _resized_grip_sensor(sensor: GripSensor, size: float) -> GripSensor:
    return replace(sensor, position=_times(sensor.position, size), radius=sensor.radius * size)


def _times(point: Point, size: float) -> Point:
    return point[0] * size, point[1] * size


def _number(name: str, text: str) -> float:
    try:
        return int(text) if text.isdecimal() else float(text)
    except ValueError:
        raise ValueError(f"parameter {name}={text}: expected a number") from None

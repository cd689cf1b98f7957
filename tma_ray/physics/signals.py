"""Meanings of observations and actions, in the order of `kernels.observe` and of the motors."""

from dataclasses import dataclass

import numpy as np

from tma_ray.embodiments import Embodiment
from tma_ray.physics.rules import LIDAR_RANGE, LIDARS, Rules, lidar_angles


@dataclass(frozen=True)
class Signal:
    """Values of an observation or an action that belong together.

    Attributes:
        name: part, joint or sensor of the values.
        meaning: observed or controlled quantity.
        unit: unit of the values; empty for a share or a flag (0 or 1).
        size: number of consecutive values.
    """

    name: str
    meaning: str
    unit: str = ""
    size: int = 1


def observation_signals(body: Embodiment, rules: Rules) -> tuple[Signal, ...]:
    """Return the signals of an observation of `body` under `rules`, in order."""
    # deferred: loads numba
    from tma_ray.physics.kernels import ANGULAR_VELOCITY_SCALE, VELOCITY_X_SCALE, VELOCITY_Y_SCALE

    signals = [
        Signal("head", "angle", "rad"),
        Signal("head", "angular velocity", f"{1 / ANGULAR_VELOCITY_SCALE:g} rad/s"),
        Signal("head", "horizontal velocity", f"{1 / VELOCITY_X_SCALE:.4g} m/s"),
        Signal("head", "vertical velocity", f"{1 / VELOCITY_Y_SCALE:.4g} m/s"),
    ]
    if rules.observes_medium:
        signals += [Signal("head", "whether it is under water"), Signal("body", "whether it is dead")]
    for joint in body.motors:
        name = _joint(joint.part_a, joint.part_b)
        signals.append(Signal(name, "angle", "rad"))
        signals.append(Signal(name, "speed", f"{joint.motor_speed:g} rad/s"))
        if joint.contact_part is not None:
            signals.append(Signal(joint.contact_part, "whether it touches ground or ceiling"))
    for sensor in body.grip_sensors:
        signals.append(Signal(_grip(sensor.part), "whether it touches something to hold"))
        signals.append(Signal(_grip(sensor.part), "whether it holds something"))
    first, last = np.rad2deg(lidar_angles(rules.lidars)[[0, -1]])
    directions = f"rays from {first:.0f}° to {last:.0f}° (0° is down, 90° ahead, 180° up)"
    distance = f"distance to what each meets, 1 for nothing; {directions}"
    signals.append(Signal("lidars", distance, f"{LIDAR_RANGE:.4g} m", LIDARS))
    if rules.observes_medium:
        kinds = "what each meets: -1 water, 1 a creeper, 0 anything else"
        signals.append(Signal("lidars", kinds, size=LIDARS))
    return tuple(signals)


def action_signals(body: Embodiment) -> tuple[Signal, ...]:
    """Return the signals of an action of `body`, in order."""
    motors = tuple(
        Signal(
            _joint(joint.part_a, joint.part_b),
            f"direction, and share of {joint.motor_torque:g} N m of torque to turn at up to "
            f"{joint.motor_speed:g} rad/s",
        )
        for joint in body.motors
    )
    return motors + tuple(
        Signal(_grip(sensor.part), "closed if over 0, else open") for sensor in body.grip_sensors
    )


def _joint(first: str, second: str) -> str:
    return f"joint of {first} and {second}"


def _grip(part: str) -> str:
    return f"grip of {part}"

"""Meanings of observations and actions, in the order of `kernels.observe` and of the motors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tma_ray.embodiments import Embodiment
from tma_ray.physics.rules import LIDAR_RANGE, LIDARS, Rules, lidar_angles


@dataclass(frozen=True)
class Signal:
    """Values of an observation or an action that belong together.

    Attributes:
        name: part, joint or sensor that the values belong to.
        meaning: quantity that is observed or controlled.
        unit: unit of the values; empty for a share or a yes (1) or no (0).
        size: number of consecutive values.
    """

    name: str
    meaning: str
    unit: str = ""
    size: int = 1


def observation_signals(body: Embodiment, rules: Rules) -> tuple[Signal, ...]:
    """Return the parts of an observation of `body` under `rules`, in order."""
    return (*_head(), *(_medium_signals() if rules.observes_medium else ()), *_limbs(body), *_lidars(rules))


def action_signals(body: Embodiment) -> tuple[Signal, ...]:
    """Return the parts of an action of `body`, in order."""
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


def _head() -> Iterator[Signal]:
    from tma_ray.physics.kernels import (
        ANGULAR_VELOCITY_SCALE,
        VELOCITY_X_SCALE,
        VELOCITY_Y_SCALE,
    )  # with numba

    yield Signal("head", "angle", "rad")
    yield Signal("head", "angular velocity", f"{1 / ANGULAR_VELOCITY_SCALE:g} rad/s")
    yield Signal("head", "horizontal velocity", f"{1 / VELOCITY_X_SCALE:.4g} m/s")
    yield Signal("head", "vertical velocity", f"{1 / VELOCITY_Y_SCALE:.4g} m/s")


def _medium_signals() -> Iterator[Signal]:
    yield Signal("head", "whether it is under water")
    yield Signal("body", "whether it is dead")


def _limbs(body: Embodiment) -> Iterator[Signal]:
    for joint in body.motors:
        name = _joint(joint.part_a, joint.part_b)
        yield Signal(name, "angle", "rad")
        yield Signal(name, "speed", f"{joint.motor_speed:g} rad/s")
        if joint.contact_part is not None:
            yield Signal(joint.contact_part, "whether it touches ground or ceiling")
    for sensor in body.grip_sensors:
        yield Signal(_grip(sensor.part), "whether it touches something to hold")
        yield Signal(_grip(sensor.part), "whether it holds something")


def _lidars(rules: Rules) -> Iterator[Signal]:
    first, last = np.rad2deg(lidar_angles(rules.lidars)[[0, -1]])
    directions = f"rays from {first:.0f}° to {last:.0f}° (0° is down, 90° ahead, 180° up)"
    yield Signal("lidars", f"distance to what each meets, 1 for nothing; {directions}", _RANGE, LIDARS)
    if rules.observes_medium:
        yield Signal("lidars", "what each meets: -1 water, 1 a creeper, 0 anything else", size=LIDARS)


_RANGE = f"{LIDAR_RANGE:.4g} m"


def _joint(first: str, second: str) -> str:
    return f"joint of {first} and {second}"


def _grip(part: str) -> str:
    return f"grip of {part}"

"""Rules of an environment, and the arrays and signals of a body under these rules."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment, GripSensor, Joint, LidarLayout, Part, Point


class BodyArrays(NamedTuple):
    """Physical properties of a body with p parts and h joints, motorised joints first."""

    mass: NDArray[np.float64]  # masses (p,) in kg, including those of a part's grip sensors
    inertia: NDArray[np.float64]  # moments of inertia about the centre of mass (p,), in kg m²
    centre: NDArray[np.float64]  # centre of mass in the part's frame (p, 2), in m
    position: NDArray[np.float64]  # origin of the part's frame relative to the spawn point (p, 2), in m
    angle: NDArray[np.float64]  # angle of the part's frame (p,), in rad
    friction: NDArray[np.float64]  # friction coefficients (p,)
    vertices: NDArray[np.float64]  # corners of all parts in their frames (v, 2), in m
    first_vertex: NDArray[np.int64]  # offset of each part's corners in `vertices`, and the end (p + 1,)
    pushed: NDArray[np.bool_]  # True for parts that are pushed in the first step (p,)
    joint_parts: NDArray[np.int64]  # indices of the two parts of each joint (h, 2)
    anchors: NDArray[np.float64]  # anchors of each joint in the frames of its two parts (h, 2, 2), in m
    limits: NDArray[np.float64]  # lowest and highest angle between the two parts (h, 2), in rad
    motors: int  # number of joints with a motor


def body_arrays(body: Embodiment) -> BodyArrays:
    """Return the physical properties of `body`."""
    counts = [len(part.shape.vertices) for part in body.parts]
    joints = (*body.motors, *body.passive_joints)
    masses = [
        _mass(part, [sensor for sensor in body.grip_sensors if sensor.part == part.name])
        for part in body.parts
    ]
    anchors, limits = [], []
    for joint in joints:
        ends = [body.parts[body.part_index(name)] for name in (joint.part_a, joint.part_b)]
        anchors.append([part.local(anchor) for part, anchor in zip(ends, joint.anchors, strict=True)])
        limits.append([limit + drawn_angle(body, joint) for limit in joint.limits])
    return BodyArrays(
        mass=np.array([mass for mass, _, _ in masses]),
        inertia=np.array([inertia for _, _, inertia in masses]),
        centre=np.array([centre for _, centre, _ in masses]),
        position=np.array([part.position for part in body.parts]) + np.array([0.0, body.spawn_height]),
        angle=np.array([part.angle for part in body.parts]),
        friction=np.array([part.friction for part in body.parts]),
        vertices=np.concatenate([part.shape.points for part in body.parts]),
        first_vertex=np.concatenate([[0], np.cumsum(counts)]),
        pushed=np.array([body.pushed and (part.head or part.pushed) for part in body.parts]),
        joint_parts=joint_parts(body, joints),
        anchors=np.array(anchors).reshape(-1, 2, 2),
        limits=np.array(limits).reshape(-1, 2),
        motors=len(body.motors),
    )


def joint_parts(body: Embodiment, joints: tuple[Joint, ...]) -> NDArray[np.int64]:
    """Return the indices (h, 2) of the two parts of each joint."""
    pairs = [[body.part_index(j.part_a), body.part_index(j.part_b)] for j in joints]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def drawn_angle(body: Embodiment, joint: Joint) -> float:
    """Return the angle between a joint's two parts in the body's reference pose, in rad."""
    first, second = (body.parts[body.part_index(name)] for name in (joint.part_a, joint.part_b))
    return second.angle - first.angle


def _mass(part: Part, sensors: list[GripSensor]) -> tuple[float, Point, float]:
    """Return mass, centre of mass and moment of inertia of `part`, including its `sensors`."""
    if not sensors:
        return part.mass, part.shape.centroid, part.inertia
    masses = np.array([part.mass, *[sensor.mass for sensor in sensors]])
    points = np.array([part.shape.centroid, *[part.local(sensor.position) for sensor in sensors]])
    inertias = np.array([part.inertia, *[sensor.inertia for sensor in sensors]])
    x, y = centre = masses @ points / masses.sum()
    inertia = np.sum(inertias + masses * np.square(points - centre).sum(axis=1))
    return float(masses.sum()), (float(x), float(y)), float(inertia)


LIDARS = 10  # number of rays
LIDAR_RANGE = 160 / 30  # length of a ray, in m
UPRIGHT_WEIGHT = 5.0  # reward per radian by which the head's tilt decreases
NO_LIMIT = -1  # stands for an unlimited number of steps

# factors that scale the observed velocities of the head
ANGULAR_VELOCITY_SCALE = 2 / 50
VELOCITY_X_SCALE = 0.3 * (600 / 30) / 50
VELOCITY_Y_SCALE = 0.3 * (400 / 30) / 50

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Rules(NamedTuple):
    """Rules of an environment, apart from its terrain."""

    environment: str  # name of the environment, which selects a body's critical parts
    lidars: LidarLayout  # directions of the rays
    # True if observations include flags for a head under water and for death, and the kind of object that
    # each ray hits
    observes_medium: bool


class StepArrays(NamedTuple):
    """Constants of a body for the kernels: p parts, v corners, j motors, g grip sensors and r lidar rays."""

    head: int  # index of the head among the parts
    observes_medium: int  # 1 if `Rules.observes_medium`, otherwise 0
    may_touch_ceiling: int  # 1 if critical parts may touch the ceiling, otherwise 0
    survivable: Integers  # steps that the body survives under water and outside it (2,), or NO_LIMIT
    critical: Integers  # 1 for parts whose contact ends the episode, otherwise 0 (p,)
    joint_parts: Integers  # indices of the two parts of each motor's joint (j, 2)
    contact_part: Integers  # index of the part whose contact is observed after each joint, or -1 (j,)
    first_vertex: Integers  # offset of each part's corners in `vertices`, and the end (p + 1,)
    grip_part: Integers  # index of the part that each sensor is welded to (g,)
    torque_cost: float  # reward deducted per action and step at full torque
    upright_weight: float  # penalty per radian of tilt
    motors: Floats  # torque in N m, speed in rad/s, and offset of the observed angle in rad (j, 3)
    rays: Floats  # ends of the lidar rays relative to the head (r, 2), in m
    vertices: Floats  # corners of all parts in their frames (v, 2), in m
    # per part: largest distance of a corner from the origin in m, moment of inertia about the origin in
    # kg m², and centre of mass in the part's frame in m (p, 4)
    bounds: Floats
    # per motor: anchor in the second part's frame in m, lowest and highest angle between the parts in rad
    # (j, 4)
    hinges: Floats
    grips: Floats  # positions of the sensors in their parts' frames, and radii, in m (g, 3)


def step_arrays(body: Embodiment, rules: Rules) -> StepArrays:
    """Return the constants of `body` under `rules`, for the kernels."""
    built, joints, sensors = body_arrays(body), body.motors, body.grip_sensors
    contacts = [-1 if j.contact_part is None else body.part_index(j.contact_part) for j in joints]
    motors = [(j.motor_torque, j.motor_speed, j.angle_offset - drawn_angle(body, j)) for j in joints]
    grips = [(*body.parts[body.part_index(s.part)].local(s.position), s.radius) for s in sensors]
    limits = (body.steps_survivable_under_water, body.steps_survivable_outside_water)
    angles, bounds = lidar_angles(rules.lidars), []
    for part in body.parts:
        x, y = part.shape.centroid
        reach = float(np.hypot(*part.shape.points.T).max())
        bounds.append((reach, part.inertia + part.mass * (x * x + y * y), x, y))
    return StepArrays(
        head=body.head,
        observes_medium=int(rules.observes_medium),
        may_touch_ceiling=int(body.may_touch_ceiling),
        survivable=np.array([NO_LIMIT if limit is None else limit for limit in limits], dtype=np.int64),
        critical=np.array([rules.environment in part.critical for part in body.parts], dtype=np.int64),
        joint_parts=joint_parts(body, joints),
        contact_part=np.array(contacts, dtype=np.int64),
        first_vertex=built.first_vertex,
        grip_part=np.array([body.part_index(sensor.part) for sensor in sensors], dtype=np.int64),
        torque_cost=body.torque_cost,
        upright_weight=UPRIGHT_WEIGHT if body.upright_reward else 0.0,
        motors=np.array(motors).reshape(-1, 3),
        rays=LIDAR_RANGE * np.stack([np.sin(angles), -np.cos(angles)], axis=1),
        vertices=built.vertices,
        bounds=np.array(bounds),
        hinges=np.concatenate([built.anchors[: len(joints), 1], built.limits[: len(joints)]], axis=1),
        grips=np.array(grips).reshape(-1, 3),
    )


def lidar_angles(layout: LidarLayout) -> Floats:
    """Return the directions of the rays (r,) in rad; 0 is down, pi/2 forward and pi up.

    Source: the original release; the paper rounds the layouts to 90, 90 and 180 degrees.
    """
    ray = np.arange(LIDARS) / LIDARS
    angles: dict[LidarLayout, Floats] = {
        LidarLayout.DOWN: 1.5 * np.arange(LIDARS) / LIDARS,
        LidarLayout.UP: 1.5 + 2.3 * ray,
        LidarLayout.FULL: np.pi * ray,
    }
    return angles[layout]


def observation_size(body: StepArrays) -> int:
    """Return the length of an observation."""
    contacts, rays = int(np.sum(body.contact_part >= 0)), len(body.rays)
    medium = 2 + rays if body.observes_medium else 0
    return 4 + 2 * len(body.motors) + contacts + 2 * len(body.grips) + rays + medium


@dataclass(frozen=True)
class Signal:
    """Description of consecutive values of an observation or an action.

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

"""Data classes of bodies, with parts, joints, motors and grip sensors."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, float]


@dataclass(frozen=True)
class Polygon:
    """Convex polygon with counter-clockwise vertices.

    Attributes:
        vertices: at least three corners (x, y), in m.

    Raises:
        ValueError: if there are fewer than three vertices, or they are not convex and counter-clockwise.
    """

    vertices: tuple[Point, ...]

    def __post_init__(self) -> None:
        if len(self.vertices) < 3:
            raise ValueError(f"a polygon needs at least 3 vertices, got {len(self.vertices)}")
        if not np.all(np.isfinite(self.points)):
            raise ValueError(f"vertices must be finite, got {list(self.vertices)}")
        edges = np.roll(self.points, -1, axis=0) - self.points
        turns = _cross(edges, np.roll(edges, -1, axis=0))
        total_turn = np.sum(np.arctan2(turns, np.sum(edges * np.roll(edges, -1, axis=0), axis=1)))
        if not (np.all(turns > 0) and np.isclose(total_turn, 2 * np.pi)):
            raise ValueError(
                f"vertices must form a convex polygon, counter-clockwise, got {list(self.vertices)}; "
                f"reorder them or split the shape into several parts"
            )

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Vertices as an array (v, 2)."""
        return np.array(self.vertices, dtype=np.float64)

    @cached_property
    def area(self) -> float:
        """Area in m²."""
        return float(np.sum(self._wedges) / 2)

    @cached_property
    def centroid(self) -> Point:
        """Centre of mass at uniform density."""
        sums = self.points + np.roll(self.points, -1, axis=0)
        x, y = (sums * self._wedges[:, None]).sum(axis=0) / (6 * self.area)
        return float(x), float(y)

    @cached_property
    def second_moment(self) -> float:
        """Polar second moment of area about the centroid, in m⁴."""
        a, b = self.points, np.roll(self.points, -1, axis=0)
        about_origin = np.sum(self._wedges * np.sum(a * a + a * b + b * b, axis=1)) / 12
        return float(about_origin - self.area * np.sum(np.square(self.centroid)))

    def distance(self, point: Point) -> float:
        """Return the largest signed distance in m of `point` from the lines of the edges, <= 0 inside."""
        edges = np.roll(self.points, -1, axis=0) - self.points
        outwards = _cross(np.asarray(point) - self.points, edges) / np.hypot(edges[:, 0], edges[:, 1])
        return float(np.max(outwards))

    @cached_property
    def _wedges(self) -> NDArray[np.float64]:
        return _cross(self.points, np.roll(self.points, -1, axis=0))


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


@dataclass(frozen=True)
class Part:
    """Rigid part with its own coordinate frame.

    Attributes:
        name: unique name in the body.
        shape: outline in the part's frame.
        position: the frame's origin relative to the spawn point, in m.
        density: density, in kg/m².
        friction: coefficient; a contact has the geometric mean of its two (Box2D's rule).
        angle: angle of the frame in the reference pose, in rad.
        head: True for the one part that sensors, reward and termination refer to.
        critical: names of environments in which a contact of this part ends the episode.
        pushed: True for a part that gets the random push at an episode's start, as the head always does.
    """

    name: str
    shape: Polygon
    position: Point
    density: float
    friction: float
    angle: float = 0.0
    head: bool = False
    critical: tuple[str, ...] = ()
    pushed: bool = False

    @property
    def mass(self) -> float:
        """Mass in kg."""
        return self.density * self.shape.area

    @property
    def inertia(self) -> float:
        """Moment of inertia about the centre of mass, in kg m²."""
        return self.density * self.shape.second_moment

    def local(self, point: Point) -> Point:
        """Transform a `point`, given relative to the spawn point in m, to the part's frame."""
        x, y = point[0] - self.position[0], point[1] - self.position[1]
        sine, cosine = math.sin(self.angle), math.cos(self.angle)
        return cosine * x + sine * y, cosine * y - sine * x

    def distance(self, point: Point) -> float:
        """Return the signed distance in m from the part to `point`, given relative to the spawn point."""
        return self.shape.distance(self.local(point))


@dataclass(frozen=True)
class Joint:
    """Hinge between two parts, either motorised or passive.

    The joint's angle is that of `part_b` minus that of `part_a`, 0 in the reference pose.

    Attributes:
        part_a: name of the part nearer to the head.
        part_b: name of the other part.
        anchor: anchor relative to the spawn point, in m.
        limits: smallest and largest angle, in rad. The body may be drawn outside them.
        motor_torque: largest torque, in N m; 0 in a passive joint, which is neither moved nor observed.
        motor_speed: target speed of the motor, in rad/s, which also scales the observed speed.
        angle_offset: offset of the observed angle, in rad.
        contact_part: name of the part whose ground contact is observed after this joint, if any.
        anchor_b: anchor on `part_b` relative to the spawn point, in m, of a joint that is drawn stretched and
            closed before an episode begins.
        outside_parts: True if the anchor may lie outside its parts, as in a neck that is not drawn.
    """

    part_a: str
    part_b: str
    anchor: Point
    limits: tuple[float, float]
    motor_torque: float = 0.0
    motor_speed: float = 0.0
    angle_offset: float = 0.0
    contact_part: str | None = None
    anchor_b: Point | None = None
    outside_parts: bool = False

    @property
    def passive(self) -> bool:
        """True if the joint has no motor."""
        return self.motor_torque == 0 and self.motor_speed == 0

    @property
    def anchors(self) -> tuple[Point, Point]:
        """Anchors of the joint on `part_a` and on `part_b`, relative to the spawn point, in m."""
        return self.anchor, self.anchor if self.anchor_b is None else self.anchor_b


@dataclass(frozen=True)
class GripSensor:
    """Circle welded to a part; it can hold objects that it touches, and does not collide.

    Attributes:
        name: unique name among the body's parts and sensors.
        part: name of the part.
        position: centre relative to the spawn point, in m.
        radius: radius, in m.
        density: density, in kg/m².
    """

    name: str
    part: str
    position: Point
    radius: float = 0.05
    density: float = 1.0

    @property
    def mass(self) -> float:
        """Mass in kg."""
        return self.density * math.pi * self.radius**2

    @property
    def inertia(self) -> float:
        """Moment of inertia about the centre, in kg m²."""
        return self.mass * self.radius**2 / 2


ANCHOR_TOLERANCE = 0.02  # largest distance of an anchor from its parts, in m (drawings are rounded to pixels)


class EmbodimentError(ValueError):
    """Error raised if a body cannot be built."""


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


def _check_connections(
    parts: Sequence[Part], joints: Sequence[Joint], grip_sensors: Sequence[GripSensor]
) -> None:
    """Check that parts, joints and grip sensors form one connected body."""
    parts_by_name = {part.name: part for part in parts}
    for index, joint in enumerate(joints):
        _check_joint(f"joint {index} ({joint.part_a} to {joint.part_b})", joint, parts_by_name)
    for sensor in grip_sensors:
        where = f"grip sensor {sensor.name!r}"
        _check_known(where, sensor.part, parts_by_name)
        if not (sensor.radius > 0 and sensor.density > 0):
            raise ValueError(
                f"{where}: radius {sensor.radius} m and density {sensor.density} kg/m² must be over 0"
            )
        distance = parts_by_name[sensor.part].distance(sensor.position)
        if not distance <= sensor.radius + ANCHOR_TOLERANCE:
            raise ValueError(
                f"{where}: position {list(sensor.position)} lies {distance:.3f} m outside part "
                f"{sensor.part!r}; the circle of radius {sensor.radius} m must touch it"
            )
    reached = {part.name for part in parts if part.head}
    for _ in parts:
        for joint in joints:
            if reached & {joint.part_a, joint.part_b}:
                reached |= {joint.part_a, joint.part_b}
    loose = [part.name for part in parts if part.name not in reached]
    if loose:
        raise ValueError(f"no joint connects part {loose[0]!r} to the head")


def _check_joint(where: str, joint: Joint, parts: dict[str, Part]) -> None:
    for name in (joint.part_a, joint.part_b, joint.contact_part):
        if name is not None:
            _check_known(where, name, parts)
    if joint.part_a == joint.part_b:
        raise ValueError(f"{where}: a joint needs two different parts")
    if not joint.limits[0] < joint.limits[1]:
        raise ValueError(f"{where}: limits {list(joint.limits)} must rise")
    if joint.passive:
        if joint.contact_part is not None or joint.angle_offset != 0:
            raise ValueError(f"{where}: a joint without motor is not observed: it has no contact_part")
    elif not (joint.motor_torque > 0 and joint.motor_speed > 0):
        raise ValueError(
            f"{where}: motor_torque {joint.motor_torque} N m and motor_speed {joint.motor_speed} rad/s "
            f"must be over 0, or both be left out in a joint without motor"
        )
    for name, anchor in zip((joint.part_a, joint.part_b), joint.anchors, strict=True):
        distance = parts[name].distance(anchor)
        if not (distance <= ANCHOR_TOLERANCE or joint.outside_parts):
            raise ValueError(
                f"{where}: anchor {list(anchor)} lies {distance:.3f} m outside part {name!r}; it must "
                f"lie in both parts, unless outside_parts = true or an anchor_b of its own say otherwise"
            )


def _check_known(where: str, name: str, parts: dict[str, Part]) -> None:
    if name not in parts:
        raise ValueError(f"{where}: no part {name!r}; the parts are {', '.join(parts)}")


class BodyType(StrEnum):
    """Type of a body by its locomotion (paper, section 4.2)."""

    WALKER = "walker"
    SWIMMER = "swimmer"
    CLIMBER = "climber"
    AMPHIBIAN = "amphibian"


class LidarLayout(StrEnum):
    """Directions of a body's lidars, from down to ahead, from ahead to up, or from down to up."""

    DOWN = "down"
    UP = "up"
    FULL = "full"


@dataclass(frozen=True)
class Embodiment:
    """Body as a connected graph of parts.

    Attributes:
        name: name in tables.
        body_type: locomotion of the body.
        spawn_height: height of the spawn point over the ground, in m.
        torque_cost: reward charged per action and step at full torque.
        upright_reward: True if the head's tilt is part of the reward.
        parts: parts, in the order of the engine's state.
        joints: joints; those with motors in the order of actions.
        substeps: steps of the simulation in a time step; light parts with strong motors need more.
        motor_share: share of the substeps, the first ones, in which the motors act, with the impulse of a
            whole time step; a whole number of substeps.
        iterations: iterations of the solver in each substep; more substeps need fewer.
        joint_correction: share of a joint's error that the solver corrects in 1/60 s, under 1. A large share
            needs more iterations, or a heavy body jerks at its light hands.
        grip_sensors: grip sensors in the order of their actions, which follow those of the motors.
        lidars: directions of the lidars in Parkour.
        steps_survivable_under_water: consecutive time steps with the head under water after which the body
            dies; None if it never does.
        steps_survivable_outside_water: same for time steps outside the water.
        may_touch_ceiling: True if a critical part may touch the ceiling.
        pushed: True if the body gets the random push at an episode's start.

    Raises:
        EmbodimentError: if the parts do not form one connected body, or a number is invalid.
    """

    name: str
    body_type: BodyType
    spawn_height: float
    torque_cost: float
    upright_reward: bool
    parts: tuple[Part, ...]
    joints: tuple[Joint, ...]
    substeps: int = 2
    motor_share: float = 1.0
    iterations: int = 30
    joint_correction: float = 0.5
    grip_sensors: tuple[GripSensor, ...] = ()
    lidars: LidarLayout = LidarLayout.DOWN
    steps_survivable_under_water: int | None = None
    steps_survivable_outside_water: int | None = None
    may_touch_ceiling: bool = False
    pushed: bool = True

    def __post_init__(self) -> None:
        try:
            self._check_numbers()
            _check_parts(self.parts, self.grip_sensors)
            _check_connections(self.parts, self.joints, self.grip_sensors)
        except ValueError as error:
            raise EmbodimentError(f"embodiment {self.name!r}: {error}") from error

    def _check_numbers(self) -> None:
        for name in ("substeps", "iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} {getattr(self, name)} must be at least 1")
        if not 0 < self.joint_correction < 1:
            raise ValueError(f"joint_correction {self.joint_correction} must be over 0 and under 1")
        driven = self.motor_share * self.substeps
        if not 1 <= driven <= self.substeps or driven != round(driven):
            raise ValueError(
                f"motor_share {self.motor_share} must be a whole number of the {self.substeps} substeps, "
                f"at least one of them: 1 / {self.substeps} to 1"
            )
        for name in ("steps_survivable_under_water", "steps_survivable_outside_water"):
            steps: object = getattr(self, name)
            whole = isinstance(steps, int) and not isinstance(steps, bool) and steps >= 0
            if steps is not None and not whole:
                raise ValueError(f"{name} {steps!r} must be a whole number of time steps, 0 or more")

    @property
    def head(self) -> int:
        """Index of the head among the parts."""
        return next(index for index, part in enumerate(self.parts) if part.head)

    @property
    def motors(self) -> tuple[Joint, ...]:
        """Joints with a motor, in the order of actions."""
        return tuple(joint for joint in self.joints if not joint.passive)

    @property
    def passive_joints(self) -> tuple[Joint, ...]:
        """Joints without a motor."""
        return tuple(joint for joint in self.joints if joint.passive)

    @property
    def stretched(self) -> bool:
        """True if any joint is drawn with two different anchors."""
        return any(joint.anchor_b is not None for joint in self.joints)

    @property
    def action_size(self) -> int:
        """Number of actions: one per motor, then one per grip sensor."""
        return len(self.motors) + len(self.grip_sensors)

    def part_index(self, name: str) -> int:
        """Return the index of the part called `name`."""
        return [part.name for part in self.parts].index(name)

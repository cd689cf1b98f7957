"""The elements of a body: rigid parts, the joints between them, and sensors that grip."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tma_ray.embodiments.polygon import Point, Polygon


@dataclass(frozen=True)
class Part:
    """One rigid part, with a frame of its own.

    Attributes:
        name: unique in the body.
        shape: outline in the part's frame.
        position: the frame's origin relative to the spawn point, in m.
        density: in kg/m².
        friction: coefficient; a contact has the geometric mean of its two (Box2D's rule).
        angle: of the frame in the pose as drawn, in rad.
        head: whether sensors, reward and termination look at this part; true of exactly one.
        critical: environments, by name, in which this part must not touch anything: it ends the episode.
        pushed: whether the random push at an episode's start acts on this part; on the head it always does.
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
        """Returns in the part's frame a `point` given relative to the spawn point, in m."""
        x, y = point[0] - self.position[0], point[1] - self.position[1]
        sine, cosine = math.sin(self.angle), math.cos(self.angle)
        return cosine * x + sine * y, cosine * y - sine * x


@dataclass(frozen=True)
class Joint:
    """A hinge between two parts, with a motor or passive.

    The joint's angle is that of `part_b` minus that of `part_a`, 0 in the pose as drawn.

    Attributes:
        part_a: name of the part nearer to the head.
        part_b: name of the other part.
        anchor: relative to the spawn point, in m.
        limits: smallest and largest angle, in rad. The body may be drawn outside them.
        motor_torque: largest torque, in N m; 0 in a passive joint, which is neither moved nor observed.
        motor_speed: speed that the motor seeks, in rad/s; also scales the observed speed.
        angle_offset: added to the observed angle, in rad.
        contact_part: part whose ground contact is observed after this joint, if any.
        anchor_b: says that the joint is drawn stretched, and where on `part_b` it is to be anchored, relative
            to the spawn point in m; such a joint is closed before an episode begins.
        outside_parts: whether the anchor may lie outside its parts, as in a neck that is not drawn.
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
    """A circle welded to a part, which may hold on to what it touches; it collides with nothing.

    Attributes:
        name: unique among the body's parts and sensors.
        part: name of the part that it is welded to.
        position: its centre relative to the spawn point, in m.
        radius: in m.
        density: in kg/m².
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

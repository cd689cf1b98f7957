"""A body as data: parts, joints and motors."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum

from tma_ray.embodiments.polygon import Point, Polygon

ANCHOR_TOLERANCE = 0.02
"""How far outside its parts a joint may be anchored, in m: drawings round to the pixel."""


class EmbodimentError(ValueError):
    """A body that cannot be built; the message names the body and the part or joint at fault."""


class BodyType(StrEnum):
    """How a body moves, which decides its lidar and what kills it (paper, section 4.2)."""

    WALKER = "walker"
    SWIMMER = "swimmer"
    CLIMBER = "climber"
    AMPHIBIAN = "amphibian"


@dataclass(frozen=True)
class Part:
    """One rigid part. Its frame has its origin at `position` and starts without rotation.

    Attributes:
        name: unique in the body.
        shape: outline in the part's frame.
        position: origin relative to the spawn point, in m.
        density: in kg/m².
        friction: coefficient; a contact has the geometric mean of its two (Box2D's rule).
        head: whether sensors, reward and termination look at this part; true of exactly one.
        critical: whether touching anything ends an episode in environments where bodies can fall.
    """

    name: str
    shape: Polygon
    position: Point
    density: float
    friction: float
    head: bool = False
    critical: bool = False

    @property
    def mass(self) -> float:
        """Mass in kg."""
        return self.density * self.shape.area

    @property
    def inertia(self) -> float:
        """Moment of inertia about the centre of mass, in kg m²."""
        return self.density * self.shape.second_moment


@dataclass(frozen=True)
class Joint:
    """A motorised hinge between two parts; the joints' order is the order of actions.

    Attributes:
        part_a: name of the part nearer to the head.
        part_b: name of the other part; the joint's angle is its angle minus that of `part_a`.
        anchor: relative to the spawn point, in m.
        limits: smallest and largest angle, in rad. The body may be drawn outside them.
        motor_torque: largest torque, in N m.
        motor_speed: speed that the motor seeks, in rad/s; also scales the observed speed.
        angle_offset: added to the observed angle, in rad.
        contact_part: part whose ground contact is observed after this joint, if any.
    """

    part_a: str
    part_b: str
    anchor: Point
    limits: tuple[float, float]
    motor_torque: float
    motor_speed: float
    angle_offset: float = 0.0
    contact_part: str | None = None


@dataclass(frozen=True)
class Embodiment:
    """A body: a tree of parts.

    Attributes:
        name: what tables call it.
        body_type: how it moves.
        spawn_height: height of the spawn point over the ground, in m.
        torque_cost: reward charged per action and step at full torque.
        upright_reward: whether the head's tilt is part of the reward.
        parts: in the order of the engine's state.
        joints: in the order of actions.

    Raises:
        EmbodimentError: parts that are not one connected body, or numbers no body can have.
    """

    name: str
    body_type: BodyType
    spawn_height: float
    torque_cost: float
    upright_reward: bool
    parts: tuple[Part, ...]
    joints: tuple[Joint, ...]

    def __post_init__(self) -> None:
        self._check_parts()
        for index, joint in enumerate(self.joints):
            self._check_joint(index, joint)
        self._check_connected()

    @property
    def head(self) -> int:
        """Index of the head among the parts."""
        return next(index for index, part in enumerate(self.parts) if part.head)

    @property
    def action_size(self) -> int:
        """Number of actions: one per motor."""
        return len(self.joints)

    def part_index(self, name: str) -> int:
        """Returns the index of the part called `name`."""
        return [part.name for part in self.parts].index(name)

    def _check_parts(self) -> None:
        repeated = [name for name, count in Counter(part.name for part in self.parts).items() if count > 1]
        if repeated:
            raise self._error(f"part name {repeated[0]!r} is used more than once; names must differ")
        heads = [part.name for part in self.parts if part.head]
        if len(heads) != 1:
            raise self._error(f"exactly one part must have head = true, got {heads or 'none'}")
        for part in self.parts:
            if not part.density > 0:
                raise self._error(f"part {part.name!r}: density {part.density} kg/m² must be over 0")
            if not part.friction >= 0:
                raise self._error(f"part {part.name!r}: friction {part.friction} must not be negative")

    def _check_joint(self, index: int, joint: Joint) -> None:
        where = f"joint {index} ({joint.part_a} to {joint.part_b})"
        parts = {part.name: part for part in self.parts}
        for name in (joint.part_a, joint.part_b, joint.contact_part):
            if name is not None and name not in parts:
                raise self._error(f"{where}: no part {name!r}; the parts are {', '.join(parts)}")
        if joint.part_a == joint.part_b:
            raise self._error(f"{where}: a joint needs two different parts")
        if not joint.limits[0] < joint.limits[1]:
            raise self._error(f"{where}: limits {list(joint.limits)} must rise")
        if not (joint.motor_torque > 0 and joint.motor_speed > 0):
            raise self._error(
                f"{where}: motor_torque {joint.motor_torque} N m and motor_speed {joint.motor_speed} rad/s "
                f"must be over 0"
            )
        for part in (parts[joint.part_a], parts[joint.part_b]):
            local = (joint.anchor[0] - part.position[0], joint.anchor[1] - part.position[1])
            if not part.shape.distance(local) <= ANCHOR_TOLERANCE:
                raise self._error(
                    f"{where}: anchor {list(joint.anchor)} lies {part.shape.distance(local):.3f} m outside "
                    f"part {part.name!r}; it must lie in both parts"
                )

    def _check_connected(self) -> None:
        reached = {self.parts[self.head].name}
        for _ in self.parts:
            for joint in self.joints:
                if reached & {joint.part_a, joint.part_b}:
                    reached |= {joint.part_a, joint.part_b}
        loose = [part.name for part in self.parts if part.name not in reached]
        if loose:
            raise self._error(f"no joint connects part {loose[0]!r} to the head")

    def _error(self, message: str) -> EmbodimentError:
        return EmbodimentError(f"embodiment {self.name!r}: {message}")

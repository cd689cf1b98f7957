"""A body as data: parts, joints and motors."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum

from tma_ray.embodiments.parts import Joint, Part

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
class Embodiment:
    """A body: a tree of parts.

    Attributes:
        name: what tables call it.
        body_type: how it moves.
        spawn_height: height of the spawn point over the ground, in m.
        torque_cost: reward charged per action and step at full torque.
        upright_reward: whether the head's tilt is part of the reward.
        parts: in the order of the engine's state.
        joints: those with motors in the order of actions.
        substeps: steps of the simulation in a time step; light parts with strong motors need more.

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
    substeps: int = 2

    def __post_init__(self) -> None:
        if self.substeps < 1:
            raise self._error(f"substeps {self.substeps} must be at least 1")
        self._check_parts()
        for index, joint in enumerate(self.joints):
            self._check_joint(index, joint)
        self._check_connected()

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
        """Whether the body is drawn with a joint stretched."""
        return any(joint.anchor_b is not None for joint in self.joints)

    @property
    def action_size(self) -> int:
        """Number of actions: one per motor."""
        return len(self.motors)

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
        self._check_motor(where, joint)
        for name, anchor in zip((joint.part_a, joint.part_b), joint.anchors, strict=True):
            distance = parts[name].shape.distance(parts[name].local(anchor))
            if not (distance <= ANCHOR_TOLERANCE or joint.outside_parts):
                raise self._error(
                    f"{where}: anchor {list(anchor)} lies {distance:.3f} m outside part {name!r}; it must "
                    f"lie in both parts, unless outside_parts = true or an anchor_b of its own say otherwise"
                )

    def _check_motor(self, where: str, joint: Joint) -> None:
        if joint.passive:
            if joint.contact_part is not None or joint.angle_offset != 0:
                raise self._error(f"{where}: a joint without motor is not observed: it has no contact_part")
        elif not (joint.motor_torque > 0 and joint.motor_speed > 0):
            raise self._error(
                f"{where}: motor_torque {joint.motor_torque} N m and motor_speed {joint.motor_speed} rad/s "
                f"must be over 0, or both be left out in a joint without motor"
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

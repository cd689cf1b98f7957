"""A body as data: parts, joints, motors, and what it can do in Parkour."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from tma_ray.embodiments.checks import EmbodimentError, check_structure
from tma_ray.embodiments.parts import GripSensor, Joint, Part


class BodyType(StrEnum):
    """Kind of locomotion of a body (paper, section 4.2)."""

    WALKER = "walker"
    SWIMMER = "swimmer"
    CLIMBER = "climber"
    AMPHIBIAN = "amphibian"


class LidarLayout(StrEnum):
    """Directions of a body's lidars in Parkour: from below to ahead, from ahead to above, or all."""

    DOWN = "down"
    UP = "up"
    FULL = "full"


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
        motor_share: share of these steps, the first ones, in which the motors act: a whole number of them, in
            which they give the impulse of a whole time step.
        iterations: of the solver in each of these steps; more steps need fewer.
        joint_correction: share of a joint's error that the solver takes back in 1/60 s, under 1. With a large
            one it needs more iterations, or a heavy body jerks at its light hands.
        grip_sensors: in the order of their actions, which come after those of the motors.
        lidars: where it looks in Parkour.
        steps_survivable_under_water: consecutive time steps with the head under water after which the body
            dies; None if it never does.
        steps_survivable_outside_water: likewise out of the water.
        may_touch_ceiling: whether a critical part may touch the ceiling.
        pushed: whether the random push at an episode's start acts on this body.

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
            check_structure(self.parts, self.joints, self.grip_sensors)
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
        """True if the body is drawn with a joint stretched."""
        return any(joint.anchor_b is not None for joint in self.joints)

    @property
    def action_size(self) -> int:
        """Number of actions: one per motor, then one per grip sensor."""
        return len(self.motors) + len(self.grip_sensors)

    @property
    def starts_hanging(self) -> bool:
        """True if the body starts hanging from the ceiling, where there is one."""
        return bool(self.grip_sensors)

    def part_index(self, name: str) -> int:
        """Returns the index of the part called `name`."""
        return [part.name for part in self.parts].index(name)

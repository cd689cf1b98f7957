"""Portable engine that uses pymunk's public API, the reference for the compiled engine."""

import math

import numpy as np
import pymunk
from numpy.typing import ArrayLike, NDArray
from pymunk import batch

from tma_ray.embodiments import Embodiment
from tma_ray.physics.base import (
    CEILING_TYPE,
    GRAVITY,
    TIME_STEP,
    SolverSettings,
    first_steps,
    motor_substeps,
    settings_for,
)
from tma_ray.physics.chipmunk import add_creepers, add_joints, add_parts, add_terrain, chains, hung, settled
from tma_ray.physics.kernels import (
    NOTHING,
    command_motors,
    count_breath,
    holder_anchor,
    observe,
    step_outcome,
    survives,
    update_grip_contacts,
    water_forces,
    world_of,
)
from tma_ray.physics.rules import Rules, observation_size, step_arrays
from tma_ray.terrain import Terrain

_FIELDS = batch.BodyFields
STATE_FIELDS = _FIELDS.POSITION | _FIELDS.ANGLE | _FIELDS.VELOCITY | _FIELDS.ANGULAR_VELOCITY


class PymunkEngine:
    """Engine that calls Chipmunk through pymunk; takes the same arguments as `make_engine`."""

    def __init__(self, body: Embodiment, rules: Rules, settings: SolverSettings | None = None) -> None:
        self.settings = settings or settings_for(body)
        self.arrays = step_arrays(body, rules)
        self._body = settled(body, self.settings)
        parts, motors, grips = len(body.parts), len(body.motors), len(body.grip_sensors)
        self.state = np.zeros((parts, 6))
        self.contacts = np.zeros((parts, 2), dtype=np.int64)
        self.grips = np.full((grips, 2), NOTHING, dtype=np.int64)
        self._grip_points, self._rotations = np.zeros((grips, 2)), np.zeros((parts, 2))
        self._forces, self._torques = np.zeros((parts, 3)), np.zeros(motors)
        self.medium = np.zeros(2, dtype=np.int64)
        self._observation_size = observation_size(self.arrays)
        self._action, self._commands = np.zeros(body.action_size), np.zeros((motors, 2))
        self._buffer = batch.Buffer()
        self._space: pymunk.Space | None = None

    def reset(self, terrain: Terrain, push: float) -> NDArray[np.float32]:
        """Build a new world and run its first steps; see `Engine`."""
        hangs = len(self.grips) > 0 and len(terrain.ceiling) > 0
        if hangs:
            terrain = hung(terrain, self._body, self.arrays)
        self._build(terrain, push)
        self.grips[:], self.medium[:], self._wet, self._shaping = NOTHING, 0, False, 0.0
        self._held: dict[int, pymunk.PivotJoint] = {}
        return first_steps(self, hangs)

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool]:
        """Advance the world by TIME_STEP; see `Engine`."""
        values = np.asarray(action)
        if self._space is None:
            raise RuntimeError("this engine has no world yet: call reset first")
        if values.shape != self._action.shape:
            raise ValueError(f"an action has shape {self._action.shape}, got {values.shape}")
        self._action[:] = values
        alive = survives(self.medium, self.arrays)
        cost = command_motors(self._action, alive, self.arrays, self._commands)
        if math.isnan(cost):
            raise ValueError(f"an action must be finite, got {values.tolist()}")
        for sensor, closing in enumerate(self._action[len(self._commands) :]):
            if closing <= 0 and sensor in self._held:
                self._space.remove(self._held.pop(sensor))
                self.grips[sensor, 1] = NOTHING
        self._advance(self._space)
        self._read_state(self._space)
        self._take_hold(self._space)
        observation = np.empty(self._observation_size, dtype=np.float32)
        observe(self.state, self.contacts, self.medium, self.grips, self.arrays, self._world, observation)
        count_breath(self.state, self._world.water_y, self.arrays, self.medium)
        reward, terminated, self._shaping = step_outcome(
            self.state, self.contacts, self.arrays, self._world.goal_x, cost, self._shaping
        )
        return observation, float(reward), bool(terminated)

    @property
    def creeper_poses(self) -> NDArray[np.float64]:
        """Poses of the creepers (c, 4); see `Engine`."""
        if self._space is None:
            raise RuntimeError("this engine has no world yet: call reset first")
        return self._world.poses

    def _build(self, terrain: Terrain, push: float) -> None:
        self._world = world_of(terrain)
        self.contacts = np.zeros_like(self.contacts)
        # a reused Space would keep counters that affect trajectories
        self._space = space = pymunk.Space()
        space.iterations = self.settings.iterations
        space.gravity = (0.0, GRAVITY)
        space.collision_slop = self.settings.collision_slop
        space.collision_bias = self.settings.collision_bias
        add_terrain(space, terrain)  # before the body: the order affects trajectories
        self._parts = add_parts(space, self._body, terrain.spawn, self.settings.skin_radius)
        self._motors, _ = add_joints(space, self._body, self._parts, self.settings)
        self._creepers = add_creepers(space, chains(terrain), self.settings)
        for part in range(len(self._parts)):
            space.on_collision(part + 1, None, begin=_touch, separate=_release, data=(self.contacts, part))
        for index in np.flatnonzero(self._body.pushed):
            centre = self._parts[index].center_of_gravity
            self._parts[index].apply_impulse_at_local_point((push * TIME_STEP, 0.0), centre)

    def _drive(self, share: float) -> None:
        """Set the motors' target speeds, and their largest torques multiplied by `share`."""
        for motor, (speed, torque) in zip(self._motors, self._commands.tolist(), strict=True):
            motor.rate = -speed  # Chipmunk's rate is the speed of the first part relative to the second
            motor.max_force = share * torque

    def _advance(self, space: pymunk.Space) -> None:
        substeps, driven = self.settings.substeps, motor_substeps(self.settings)
        duration, share = TIME_STEP / substeps, substeps / driven
        for index in range(substeps):
            if index == 0:
                self._drive(share)
            elif index == driven:
                self._drive(0.0)
            if self._wet:  # Chipmunk resets forces after each step
                for part, (x, y, torque) in zip(self._parts, self._forces.tolist(), strict=True):
                    part.force, part.torque = (x, y), torque
            space.step(duration)
            if index == driven - 1:  # torques are impulses divided by the time in which the motors act
                for joint, motor in enumerate(self._motors):
                    torque = motor.impulse / (duration * share)
                    self._torques[joint] = math.copysign(torque, self._commands[joint, 0])

    def _read_state(self, space: pymunk.Space) -> None:
        self._buffer.clear()
        batch.get_space_bodies(space, STATE_FIELDS, self._buffer)
        values = np.frombuffer(self._buffer.float_buf())  # parts first, then creepers and the static body
        self.state[:] = values[: self.state.size].reshape(self.state.shape)
        for index, creeper in self._creepers.items():
            self._world.poses[index] = *creeper.position, *creeper.rotation_vector
        lowest = np.min(self.state[:, 1] - self.arrays.bounds[:, 0])
        if len(self.grips) or lowest < self._world.water_y:
            self._rotations[:] = [part.rotation_vector for part in self._parts]
        self._wet = False
        if lowest < self._world.water_y:
            self._wet = water_forces(
                self.state, self._rotations, self._torques, self.arrays, self._world.water_y, self._forces
            )

    def _take_hold(self, space: pymunk.Space) -> None:
        update_grip_contacts(
            self.state, self._rotations, self.arrays, self._world, self._grip_points, self.grips
        )
        for sensor, closing in enumerate(self._action[len(self._commands) :]):
            touched = int(self.grips[sensor, 0])
            if closing > 0 and sensor not in self._held and touched != NOTHING:
                holder = self._creepers.get(touched, space.static_body)
                anchor = holder_anchor(self._grip_points[sensor], touched, self._world)
                part = self._parts[self.arrays.grip_part[sensor]]
                position = tuple(self.arrays.grips[sensor, :2].tolist())
                pivot = pymunk.PivotJoint(holder, part, anchor, position)
                pivot.error_bias = self.settings.joint_error_bias
                space.add(pivot)
                self._held[sensor] = pivot
                self.grips[sensor, 1] = touched


def _touch(arbiter: pymunk.Arbiter, _space: pymunk.Space, data: tuple[NDArray[np.int64], int]) -> None:
    contacts, part = data
    contacts[part, _is_ceiling(arbiter)] += 1


def _release(arbiter: pymunk.Arbiter, _space: pymunk.Space, data: tuple[NDArray[np.int64], int]) -> None:
    contacts, part = data
    contacts[part, _is_ceiling(arbiter)] -= 1


def _is_ceiling(arbiter: pymunk.Arbiter) -> int:
    return int(any(shape.collision_type == CEILING_TYPE for shape in arbiter.shapes))

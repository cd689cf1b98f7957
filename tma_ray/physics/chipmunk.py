"""Construction of bodies, terrain and creepers in a Chipmunk space."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import pymunk
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment
from tma_ray.physics.base import CEILING_TYPE, TIME_STEP, SolverSettings
from tma_ray.physics.rules import BodyArrays, StepArrays, body_arrays
from tma_ray.terrain import FIXED, Terrain

SETTLING_STEPS = 20  # steps to correct a body's joint angles; the softest joints keep 2 % of the error
CLOSING_SWEEPS = 60  # passes that correct all joints of a stretched body (like Box2D's position iterations)
CONTACT_CORRECTION = 0.2  # share of a penetration corrected per sweep (as in Box2D)


def add_terrain(space: pymunk.Space, terrain: Terrain) -> None:
    """Add the solids of `terrain` to `space`, those of the ceiling with the collision type CEILING_TYPE."""
    shapes = [pymunk.Poly(space.static_body, corners) for corners in terrain.solids.tolist()]
    for index, shape in enumerate(shapes):
        shape.friction = math.sqrt(terrain.friction)
        if index >= terrain.ground_solids:
            shape.collision_type = CEILING_TYPE
    space.add(*shapes)


def add_parts(
    space: pymunk.Space, body: BodyArrays, spawn: NDArray[np.float64], skin_radius: float
) -> list[pymunk.Body]:
    """Add the parts of `body` to `space`, part i with the collision type i + 1, and return them."""
    parts = []
    for index in range(len(body.mass)):
        part = pymunk.Body(body.mass[index], body.inertia[index])
        part.center_of_gravity = tuple(body.centre[index].tolist())
        part.angle = float(body.angle[index])
        part.position = tuple((spawn + body.position[index]).tolist())
        corners = body.vertices[body.first_vertex[index] : body.first_vertex[index + 1]]
        shape = pymunk.Poly(part, corners.tolist(), radius=skin_radius)
        # Chipmunk multiplies the two coefficients of a contact; Box2D takes the square root of their product
        shape.friction = math.sqrt(body.friction[index])
        shape.filter = pymunk.ShapeFilter(group=1)  # parts in one group do not collide
        shape.collision_type = index + 1
        space.add(part, shape)
        parts.append(part)
    return parts


def add_joints(
    space: pymunk.Space, body: BodyArrays, parts: list[pymunk.Body], settings: SolverSettings
) -> tuple[list[pymunk.SimpleMotor], list[pymunk.RotaryLimitJoint]]:
    """Add the joints of `body` to `space` and return their motors and limits."""
    motors, limits = [], []
    for index, ((a, b), anchors, (low, high)) in enumerate(
        zip(body.joint_parts.tolist(), body.anchors.tolist(), body.limits.tolist(), strict=True)
    ):
        if index < body.motors:  # motor, limit, pivot: Box2D solves a joint in this order
            motors.append(pymunk.SimpleMotor(parts[a], parts[b], 0.0))
            motors[-1].max_force = 0.0
            space.add(motors[-1])
        limit = pymunk.RotaryLimitJoint(parts[a], parts[b], low, high)
        limit.max_bias = settings.limit_correction_speed
        pivot = pymunk.PivotJoint(parts[a], parts[b], *map(tuple, anchors))
        limit.error_bias = pivot.error_bias = settings.joint_error_bias
        space.add(limit, pivot)
        limits.append(limit)
    return motors, limits


def hung(terrain: Terrain, body: BodyArrays, step: StepArrays) -> Terrain:
    """Return `terrain` with a spawn point at which the highest grip sensor touches the ceiling."""
    heights = []
    for part, (x, y, _) in zip(step.grip_part, step.grips, strict=True):
        turned = math.sin(body.angle[part]) * x + math.cos(body.angle[part]) * y
        heights.append(body.position[part, 1] + turned)
    above = np.searchsorted(terrain.ceiling[:, 2], terrain.spawn[0])
    return terrain._replace(spawn=np.array([terrain.spawn[0], terrain.ceiling[above, 1] - max(heights)]))


@cache
def settled(embodiment: Embodiment, settings: SolverSettings) -> BodyArrays:
    """Return arrays of `embodiment`, posed within joint limits, with each joint's anchors brought together.

    Bodies are drawn straight, which may be outside their limits. Box2D corrects that within the first step
    and without adding velocity; Chipmunk would add some, so the pose is computed in an empty space.
    """
    body = body_arrays(embodiment)
    if embodiment.stretched:
        body = _closed(body, settings)
    space, parts = _still_space(body, settings)
    for _ in range(SETTLING_STEPS):
        space.step(TIME_STEP)
    return _posed(body, parts)


def _closed(body: BodyArrays, settings: SolverSettings) -> BodyArrays:
    """Return `body` standing on the ground, with the two anchors of each joint brought together.

    Joints and contacts are corrected one after the other, as in Box2D, so that straight legs buckle; solving
    for all of them at once would lift the body onto stiff legs.
    """
    for _ in range(CLOSING_SWEEPS):
        space, parts = _still_space(body, settings)  # a reused space would keep impulses
        space.iterations = 1
        for constraint in space.constraints:
            constraint.error_bias = 0.0
        space.collision_bias = (1 - CONTACT_CORRECTION) ** (1 / TIME_STEP)
        space.collision_slop = settings.collision_slop
        space.add(
            pymunk.Poly(space.static_body, [(-100.0, -10.0), (100.0, -10.0), (100.0, 0.0), (-100.0, 0.0)])
        )
        for _ in range(2):  # corrections of the first step move the parts in the second
            space.step(TIME_STEP)
        body = _posed(body, parts)
    return body


def _still_space(body: BodyArrays, settings: SolverSettings) -> tuple[pymunk.Space, list[pymunk.Body]]:
    """Return a space that contains `body`, without gravity and with full damping, and the body's parts."""
    space = pymunk.Space()
    space.damping = 0.0
    parts = add_parts(space, body, np.zeros(2), settings.skin_radius)
    _, limits = add_joints(space, body, parts, settings)
    for limit in limits:
        limit.max_bias = math.inf
    return space, parts


def _posed(body: BodyArrays, parts: list[pymunk.Body]) -> BodyArrays:
    """Return `body` in the current pose of its `parts`."""
    return body._replace(
        position=np.array([part.position for part in parts]), angle=np.array([part.angle for part in parts])
    )


DENSITY = 5.0  # density of creepers, in kg/m² (original release)
LARGEST_ANGLE = 0.4 * np.pi  # largest angle between a creeper and its holder, in rad (original release)


class Chains(NamedTuple):
    """Physical properties of c creepers, empty if none of them swings.

    Values of fixed creepers are not used.
    """

    holders: NDArray[np.int64]  # holders (c,), as in Terrain
    mass: NDArray[np.float64]  # masses (c,), in kg
    inertia: NDArray[np.float64]  # moments of inertia about the centres (c,), in kg m²
    centre: NDArray[np.float64]  # centres at rest (c, 2), in m
    anchors: NDArray[np.float64]  # hinges (c, 2, 2), in m, in the frames of the holder and of the creeper


def chains(terrain: Terrain) -> Chains:
    """Return the physical properties of the creepers of `terrain`."""
    if not (terrain.holders != FIXED).any():
        return Chains(np.empty(0, np.int64), *(np.empty((0, *rest)) for rest in ((), (), (2,), (2, 2))))
    low, high = terrain.creepers[:, :2], terrain.creepers[:, 2:]
    sizes, centre = high - low, (low + high) / 2
    mass = DENSITY * sizes.prod(axis=1)
    anchors = np.zeros((len(centre), 2, 2))
    anchors[:, 0] = np.stack([centre[:, 0], high[:, 1]], axis=1)
    held = np.flatnonzero(terrain.holders >= 0)
    anchors[held, 0, 0] = 0.0
    anchors[held, 0, 1] = -sizes[terrain.holders[held], 1] / 2
    anchors[:, 1, 1] = sizes[:, 1] / 2
    inertia = mass * np.square(sizes).sum(axis=1) / 12
    return Chains(terrain.holders, mass, inertia, centre, anchors)


def add_creepers(space: pymunk.Space, creepers: Chains, settings: SolverSettings) -> dict[int, pymunk.Body]:
    """Add the swinging creepers to `space` and return their bodies by creeper index."""
    bodies: dict[int, pymunk.Body] = {}
    for index in np.flatnonzero(creepers.holders != FIXED).tolist():
        body = pymunk.Body(creepers.mass[index], creepers.inertia[index])
        body.position = tuple(creepers.centre[index].tolist())
        bodies[index] = body
        holder = bodies.get(int(creepers.holders[index]), space.static_body)
        limit = pymunk.RotaryLimitJoint(holder, body, -LARGEST_ANGLE, LARGEST_ANGLE)
        limit.max_bias = settings.limit_correction_speed
        pivot = pymunk.PivotJoint(holder, body, *map(tuple, creepers.anchors[index].tolist()))
        limit.error_bias = pivot.error_bias = settings.joint_error_bias
        space.add(body, limit, pivot)
    return bodies

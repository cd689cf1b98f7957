"""Compiled counterpart of chipmunk.py; objects are added in the same order, which affects trajectories."""

import math

import numpy as np
from numba import carray, cfunc  # type: ignore[attr-defined]
from numpy.typing import NDArray

import tma_ray.physics.compiled.symbols as cp
from tma_ray.physics.base import CEILING_TYPE, SolverSettings
from tma_ray.physics.chipmunk import LARGEST_ANGLE, Chains
from tma_ray.physics.rules import BodyArrays
from tma_ray.support.jit import kernel
from tma_ray.terrain import FIXED, Terrain

Floats = NDArray[np.float64]
Handles = NDArray[np.int64]  # pointers to objects of Chipmunk
PARTS_GROUP = 1  # shapes in one group do not collide
EVERY_CATEGORY = -1  # all bits of a filter's categories and mask


@cfunc("void(intp, intp, CPointer(int64))", cache=True)
def count_contact(_body, arbiter, counts):  # type: ignore[no-untyped-def]
    """Add a contact to the `counts` (2,) for ground and ceiling; callback of cpBodyEachArbiter."""
    kind = cp.shape_collision_type(cp.other_shape(arbiter))
    carray(counts, 2)[1 if kind == CEILING_TYPE else 0] += 1


@kernel
def build(
    body: BodyArrays,
    terrain: Terrain,
    creepers: Chains,
    settings: SolverSettings,
    forces: tuple[float, float],
    handles: Handles,
) -> tuple[Handles, Handles]:
    """Build a world, and write pointers to its objects to `handles`, in the order of `SimulationState`.

    `forces` are the upward gravity in m/s², and the forward impulse on pushed parts in N s.

    Returns:
        Pointers to the shapes, and to each creeper's body, limit and pivot (c, 3), 0 for fixed creepers.
    """
    gravity, impulse = forces
    parts, solids = len(body.mass), len(terrain.solids)
    shapes, swinging = np.empty(solids + parts, np.int64), np.zeros((len(terrain.creepers), 3), np.int64)
    space = cp.space_new()
    handles[0] = space
    cp.space_set_iterations(space, settings.iterations)
    cp.space_set_gravity(space, 0.0, gravity)
    cp.space_set_collision_slop(space, settings.collision_slop)
    cp.space_set_collision_bias(space, settings.collision_bias)
    add_terrain(space, terrain, shapes)
    add_parts(space, body, terrain.spawn, settings.skin_radius, handles[1 : 1 + parts], shapes[solids:])
    add_joints(space, body, settings, handles)
    add_creepers(space, creepers, settings, swinging)
    for part in range(parts):
        if body.pushed[part]:
            cp.body_push(handles[1 + part], impulse, 0.0, body.centre[part, 0], body.centre[part, 1])
    return shapes, swinging


@kernel
def release(handles: Handles, holds: Handles, shapes: Handles, swinging: Handles, parts: int) -> None:
    """Free a world whose body has `parts` parts, including the constraints of closed grips in `holds`."""
    cp.space_free(handles[0])
    for shape in shapes:
        cp.shape_free(shape)
    for constraint in handles[1 + parts :]:
        cp.constraint_free(constraint)
    for constraint in holds:
        if constraint != 0:
            cp.constraint_free(constraint)
    for part in handles[1 : 1 + parts]:
        cp.body_free(part)
    for creeper in swinging:
        if creeper[0] != 0:
            cp.constraint_free(creeper[1])
            cp.constraint_free(creeper[2])
            cp.body_free(creeper[0])


@kernel
def polygon(body: int, corners: Floats, radius: float) -> int:
    """Return a new shape, the convex hull of `corners` (v, 2), with Chipmunk's order of corners."""
    hull = corners.copy()
    count = cp.convex_hull(len(hull), hull.ctypes.data, hull.ctypes.data, 0, 0.0)
    shape: int = cp.polygon_new(body, count, hull.ctypes.data, radius)
    return shape


@kernel
def add_terrain(space: int, terrain: Terrain, shapes: Handles) -> None:
    """Add the solids of `terrain`, and write their shapes to `shapes`."""
    ground = cp.space_static_body(space)
    for index in range(len(terrain.solids)):
        shapes[index] = polygon(ground, terrain.solids[index], 0.0)
        cp.shape_set_friction(shapes[index], math.sqrt(terrain.friction))
        if index >= terrain.ground_solids:
            cp.shape_set_collision_type(shapes[index], CEILING_TYPE)
        cp.space_add_shape(space, shapes[index])


@kernel
def add_parts(
    space: int, body: BodyArrays, spawn: Floats, radius: float, parts: Handles, shapes: Handles
) -> None:
    """Add the parts of `body`, and write their bodies to `parts` and their shapes to `shapes`."""
    for index in range(len(body.mass)):
        part = cp.body_new(body.mass[index], body.inertia[index])
        cp.body_set_centre(part, body.centre[index, 0], body.centre[index, 1])
        cp.body_set_angle(part, body.angle[index])
        x, y = spawn[0] + body.position[index, 0], spawn[1] + body.position[index, 1]
        cp.body_set_position(part, x, y)
        corners = body.vertices[body.first_vertex[index] : body.first_vertex[index + 1]]
        shape = polygon(part, corners, radius)
        cp.shape_set_friction(shape, math.sqrt(body.friction[index]))
        cp.shape_set_filter(shape, PARTS_GROUP, EVERY_CATEGORY)
        cp.space_add_body(space, part)
        cp.space_add_shape(space, shape)
        parts[index], shapes[index] = part, shape


@kernel
def add_joints(space: int, body: BodyArrays, settings: SolverSettings, handles: Handles) -> None:
    """Add the joints of `body` between the parts in `handles`, and write their constraints to `handles`."""
    joints = len(body.limits)
    parts = handles[1 : 1 + len(body.mass)]
    constraints = handles[1 + len(body.mass) :]
    for index in range(joints):
        a, b = parts[body.joint_parts[index, 0]], parts[body.joint_parts[index, 1]]
        if index < body.motors:  # motor, limit, pivot: Box2D solves a joint in this order
            motor = cp.motor_new(a, b, 0.0)
            cp.constraint_set_max_force(motor, 0.0)
            cp.space_add_constraint(space, motor)
            constraints[index] = motor
        low, high = body.limits[index]
        limit, pivot = hinge(space, (a, b), body.anchors[index], (low, high), settings)
        constraints[body.motors + index], constraints[body.motors + joints + index] = limit, pivot


@kernel
def hinge(
    space: int, parts: tuple[int, int], anchor: Floats, limits: tuple[float, float], settings: SolverSettings
) -> tuple[int, int]:
    """Join two bodies by a hinge with `limits`, and return its limit and pivot constraints.

    The `anchor` (2, 2) is given in the frames of both bodies.
    """
    a, b = parts
    limit = cp.limit_new(a, b, limits[0], limits[1])
    cp.constraint_set_max_bias(limit, settings.limit_correction_speed)
    cp.constraint_set_error_bias(limit, settings.joint_error_bias)
    pivot = cp.pivot_new(a, b, anchor[0, 0], anchor[0, 1], anchor[1, 0], anchor[1, 1])
    cp.constraint_set_error_bias(pivot, settings.joint_error_bias)
    cp.space_add_constraint(space, limit)
    cp.space_add_constraint(space, pivot)
    return limit, pivot


@kernel
def add_creepers(space: int, creepers: Chains, settings: SolverSettings, swinging: Handles) -> None:
    """Add the swinging creepers, and write their bodies, limits and pivots to `swinging` (c, 3)."""
    for index in range(len(creepers.mass)):
        if creepers.holders[index] == FIXED:
            continue
        body = cp.body_new(creepers.mass[index], creepers.inertia[index])
        cp.body_set_position(body, creepers.centre[index, 0], creepers.centre[index, 1])
        holder = cp.space_static_body(space)
        if creepers.holders[index] >= 0:
            holder = swinging[creepers.holders[index], 0]
        cp.space_add_body(space, body)
        limits = -LARGEST_ANGLE, LARGEST_ANGLE
        limit, pivot = hinge(space, (holder, body), creepers.anchors[index], limits, settings)
        swinging[index, 0], swinging[index, 1], swinging[index, 2] = body, limit, pivot

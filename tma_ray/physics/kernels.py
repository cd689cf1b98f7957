"""Kernels of motors, lidars, grips, water, reward and termination, shared by all engines.

The functions run compiled or as plain Python, with the same bits. Their arguments, unless described:

- `state` (p, 6): each part's origin x, y, angle, velocity x, y of its centre of mass, and angular velocity
  (m, rad, s); `rotations` (p, 2): cosine and sine of each part's angle;
- `contacts` (p, 2): numbers of ground and of ceiling solids that each part touches;
- `medium` (2,): consecutive steps under water and outside it;
- `grips` (g, 2): object that each grip sensor touches and holds.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.physics.rules import ANGULAR_VELOCITY_SCALE, VELOCITY_X_SCALE, VELOCITY_Y_SCALE, StepArrays
from tma_ray.support.jit import kernel
from tma_ray.terrain import FIXED, Terrain


class World(NamedTuple):
    """Terrain, water and creepers, as used by sensors and grips."""

    ground: NDArray[np.float64]  # lidar segments of the ground (m, 4), as in Terrain
    ceiling: NDArray[np.float64]  # lidar segments of the ceiling (k, 4), as in Terrain
    creepers: NDArray[np.float64]  # rectangles at rest (c, 4), as in Terrain
    poses: NDArray[np.float64]  # poses of the creepers (c, 4): centre in m, cosine and sine of the angle
    movable: NDArray[np.int64]  # 1 for swinging creepers, otherwise 0 (c,)
    sway: float  # largest distance of any creeper from its rest position, in m
    water_y: float  # height of the water's surface, in m; -inf in a dry world
    goal_x: float  # x of the goal, in m


def world_of(terrain: Terrain) -> World:
    """Return the world of `terrain`, with creepers at rest and contiguous arrays."""
    poses = np.zeros((len(terrain.creepers), 4))
    poses[:, :2] = (terrain.creepers[:, :2] + terrain.creepers[:, 2:]) / 2
    poses[:, 2] = 1.0
    movable = terrain.holders != FIXED
    return World(
        np.ascontiguousarray(terrain.surface),
        np.ascontiguousarray(terrain.ceiling),
        np.ascontiguousarray(terrain.creepers),
        poses,
        movable.astype(np.int64),
        _longest_chain(terrain) if movable.any() else 0.0,
        terrain.water_y,
        terrain.goal_x,
    )


def _longest_chain(terrain: Terrain) -> float:
    """Return the length of the longest chain of creepers, in m."""
    lengths = terrain.creepers[:, 3] - terrain.creepers[:, 1]
    for index, holder in enumerate(terrain.holders):
        if holder >= 0:
            lengths[index] += lengths[holder]
    return float(lengths.max())


Floats = NDArray[np.float64]

# side on which a surface's segments are solid: the right (1) or the left (-1)
GROUND_SIDE, CEILING_SIDE = 1.0, -1.0
SOLID, CREEPER, WATER = 0.0, 1.0, -1.0  # kinds of objects hit by a lidar; SOLID also if nothing is hit


@kernel
def cast_ray(x: float, y: float, ray: Floats, world: World) -> tuple[float, float]:
    """Return the fraction of a ray's length at which it first hits an object, and the kind of object.

    Without a hit, the fraction is 1. Objects that contain the start (x, y) are not hit. The end of `ray` (2,)
    is relative to the start, in m.
    """
    nearest = hit_fraction(x, y, ray, world.ground, GROUND_SIDE)
    if len(world.ceiling) > 0:
        nearest = min(nearest, hit_fraction(x, y, ray, world.ceiling, CEILING_SIDE))
    kind = SOLID
    if len(world.creepers) > 0:
        fraction = _creeper_fraction(x, y, ray, world)
        if fraction < nearest:
            nearest, kind = fraction, CREEPER
    if y > world.water_y and y + ray[1] < world.water_y:
        fraction = (world.water_y - y) / ray[1]
        if fraction < nearest:
            nearest, kind = fraction, WATER
    return nearest, kind


@kernel
def first_segment(surface: Floats, x: float) -> int:
    """Return the index of the first segment of `surface` (m, 4) that ends at `x` or later (bisection)."""
    low, high = 0, len(surface)
    while low < high:
        middle = (low + high) // 2
        if surface[middle, 2] < x:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def hit_fraction(x: float, y: float, ray: Floats, surface: Floats, side: float) -> float:
    """Return the fraction of a ray's length at which it hits `surface` (m, 4), or 1 without a hit."""
    nearest = 1.0
    reach = max(x, x + ray[0])
    index = first_segment(surface, min(x, x + ray[0]))
    while index < len(surface) and surface[index, 0] <= reach:
        start_x, start_y = surface[index, 0] - x, surface[index, 1] - y
        along_x, along_y = surface[index, 2] - surface[index, 0], surface[index, 3] - surface[index, 1]
        inwards = ray[1] * along_x - ray[0] * along_y
        if side * inwards < 0:
            along_ray = (start_y * along_x - start_x * along_y) / inwards
            along_segment = (start_y * ray[0] - start_x * ray[1]) / inwards
            if 0 <= along_ray < nearest and 0 <= along_segment <= 1:
                nearest = along_ray
        index += 1
    return nearest


@kernel
def creepers_between(left: float, right: float, world: World) -> tuple[int, int]:
    """Return a range of indices that includes all creepers between two values of x, in m."""
    first = first_segment(world.creepers, left - world.sway)
    last = first
    while last < len(world.creepers) and world.creepers[last, 0] <= right + world.sway:
        last += 1
    return first, last


@kernel
def _creeper_fraction(x: float, y: float, ray: Floats, world: World) -> float:
    """Return the fraction of a ray's length at which it first hits a creeper, or 1 without a hit."""
    nearest = 1.0
    first, last = creepers_between(min(x, x + ray[0]), max(x, x + ray[0]), world)
    for index in range(first, last):
        nearest = min(nearest, _box_fraction(x, y, ray, world.creepers[index], world.poses[index]))
    return nearest


@kernel
def _box_fraction(x: float, y: float, ray: Floats, rectangle: Floats, pose: Floats) -> float:
    """Return the fraction of a ray's length at which it hits a rectangle, or 1 without a hit.

    The ray is clipped by the rectangle's two pairs of sides, in the rectangle's axes.
    """
    cosine, sine = pose[2], pose[3]
    along, across = x - pose[0], y - pose[1]
    enter, leave = 0.0, 1.0
    outside = False
    for axis in range(2):
        half = (rectangle[axis + 2] - rectangle[axis]) / 2
        if axis == 0:
            start, step = cosine * along + sine * across, cosine * ray[0] + sine * ray[1]
        else:
            start, step = cosine * across - sine * along, cosine * ray[1] - sine * ray[0]
        outside = outside or abs(start) > half
        if step == 0.0:
            if abs(start) > half:
                return 1.0
        else:
            near, far = (-half - start) / step, (half - start) / step
            enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
    return enter if outside and enter <= leave else 1.0


SKIN = 0.01  # reach of grip sensors beyond their radius, in m (margin of polygons in the original release)
NOTHING, CEILING = -2, -1  # values of `grips` besides the indices of creepers


@kernel
def update_grip_contacts(
    state: Floats, rotations: Floats, body: StepArrays, world: World, points: Floats, grips: NDArray[np.int64]
) -> None:
    """Write the positions of the grip sensors in m to `points` (g, 2), and touched objects to `grips`."""
    for sensor in range(len(body.grips)):
        part = body.grip_part[sensor]
        x, y, radius = body.grips[sensor]
        cosine, sine = rotations[part]
        points[sensor, 0] = state[part, 0] + cosine * x - sine * y
        points[sensor, 1] = state[part, 1] + sine * x + cosine * y
        grips[sensor, 0] = graspable(points[sensor, 0], points[sensor, 1], radius + SKIN, world)


@kernel
def graspable(x: float, y: float, reach: float, world: World) -> int:
    """Return what is within `reach` m of a point, as the index of a creeper, CEILING or NOTHING."""
    first, last = creepers_between(x - reach, x + reach, world)
    for index in range(first, last):
        if _near_box(x, y, reach, world.creepers[index], world.poses[index]):
            return index
    index = first_segment(world.ceiling, x - reach)
    while index < len(world.ceiling) and world.ceiling[index, 0] <= x + reach:
        if _near_segment(x, y, reach, world.ceiling[index]):
            return CEILING
        index += 1
    return NOTHING


@kernel
def _near_box(x: float, y: float, reach: float, rectangle: Floats, pose: Floats) -> bool:
    along, across = x - pose[0], y - pose[1]
    side = abs(pose[2] * along + pose[3] * across) - (rectangle[2] - rectangle[0]) / 2
    end = abs(pose[2] * across - pose[3] * along) - (rectangle[3] - rectangle[1]) / 2
    side, end = max(side, 0.0), max(end, 0.0)
    near: bool = side * side + end * end <= reach * reach
    return near


@kernel
def _near_segment(x: float, y: float, reach: float, segment: Floats) -> bool:
    along_x, along_y = segment[2] - segment[0], segment[3] - segment[1]
    from_x, from_y = x - segment[0], y - segment[1]
    share = (from_x * along_x + from_y * along_y) / (along_x * along_x + along_y * along_y)
    share = min(max(share, 0.0), 1.0)
    off_x, off_y = from_x - share * along_x, from_y - share * along_y
    near: bool = math.sqrt(off_x * off_x + off_y * off_y) <= reach
    return near


@kernel
def holder_anchor(point: Floats, held: int, world: World) -> tuple[float, float]:
    """Return `point` in the frame of the `held` swinging creeper, or of the world for other objects."""
    if held < 0 or world.movable[held] == 0:
        return point[0], point[1]
    pose = world.poses[held]
    along, across = point[0] - pose[0], point[1] - pose[1]
    return pose[2] * along + pose[3] * across, pose[2] * across - pose[3] * along


Integers = NDArray[np.int64]

FORWARD_WEIGHT = 130 / 30  # reward per metre that the head moves forward
FALL_REWARD = -100.0  # reward of a step in which the body falls or moves behind the start


@kernel
def command_motors(action: Floats, alive: bool, body: StepArrays, commands: Floats) -> float:
    """Write the motors' target speeds (rad/s) and largest torques (N m) to `commands` (j, 2).

    The sign of an action is the direction, its absolute value (at most 1) the share of the torque; 0 leaves
    the joint limp. `action` (j + g,) becomes 0 if the body is not `alive`.

    Returns:
        Cost of the actions in reward; NaN if one is not finite.
    """
    effort = 0.0
    for index in range(len(action)):
        if not math.isfinite(action[index]):
            return math.nan
        if not alive:
            action[index] = 0.0
        value = action[index]
        share = min(abs(value), 1.0)
        effort += share
        if index < len(commands):
            direction = 1.0 if value > 0 else (-1.0 if value < 0 else 0.0)
            commands[index, 0] = direction * body.motors[index, 1]
            commands[index, 1] = share * body.motors[index, 0]
    return effort * body.torque_cost


@kernel
def survives(medium: Integers, body: StepArrays) -> bool:
    """Return True if the body has not been under or outside water for too long."""
    drowned = 0 <= body.survivable[0] < medium[0]
    dried = 0 <= body.survivable[1] < medium[1]
    return not (drowned or dried)


@kernel
def count_breath(state: Floats, water_y: float, body: StepArrays, medium: Integers) -> None:
    """Count a step under or outside water in `medium`, unless the body is dead."""
    if survives(medium, body):
        submerged = state[body.head, 1] <= water_y
        medium[0] = medium[0] + 1 if submerged else 0
        medium[1] = 0 if submerged else medium[1] + 1


@kernel
def observe(
    state: Floats,
    contacts: Integers,
    medium: Integers,
    grips: Integers,
    body: StepArrays,
    world: World,
    observation: NDArray[np.float32],
) -> None:
    """Write the `observation` (o,), in the units and order of the original release.

    Its values are the head's state; with `observes_medium`, flags for a head under water and for a body that
    was dead before the step; joints and contacts; flags for grip sensors that touch and that hold; lidar
    distances and the kinds of objects hit. `medium` is from before this step.
    """
    head = state[body.head]
    observation[0] = head[2]
    observation[1] = ANGULAR_VELOCITY_SCALE * head[5]
    observation[2] = VELOCITY_X_SCALE * head[3]
    observation[3] = VELOCITY_Y_SCALE * head[4]
    index = 4
    if body.observes_medium:
        observation[index] = 1.0 if head[1] <= world.water_y else 0.0
        observation[index + 1] = 0.0 if survives(medium, body) else 1.0
        index += 2
    for joint in range(len(body.joint_parts)):
        a, b = state[body.joint_parts[joint, 0]], state[body.joint_parts[joint, 1]]
        observation[index] = b[2] - a[2] + body.motors[joint, 2]
        observation[index + 1] = (b[5] - a[5]) / body.motors[joint, 1]
        index += 2
        if body.contact_part[joint] >= 0:
            touches = contacts[body.contact_part[joint]]
            observation[index] = 1.0 if touches[0] + touches[1] > 0 else 0.0
            index += 1
    for sensor in range(len(grips)):
        observation[index] = 1.0 if grips[sensor, 0] != NOTHING else 0.0
        observation[index + 1] = 1.0 if grips[sensor, 1] != NOTHING else 0.0
        index += 2
    _observe_lidars(head, body, world, observation[index:])


@kernel
def _observe_lidars(head: Floats, body: StepArrays, world: World, observation: NDArray[np.float32]) -> None:
    """Write the distances at which the lidar rays hit, and the kinds of objects hit, to `observation`."""
    rays = len(body.rays)
    for ray in range(rays):
        fraction, kind = cast_ray(head[0], head[1], body.rays[ray], world)
        observation[ray] = fraction
        if body.observes_medium:
            observation[rays + ray] = kind


@kernel
def shaping(state: Floats, body: StepArrays) -> float:
    """Return the potential of the reward shaping, weighted progress of the head minus weighted tilt."""
    head = state[body.head]
    potential: float = FORWARD_WEIGHT * head[0] - body.upright_weight * abs(head[2])
    return potential


@kernel
def has_fallen(state: Floats, contacts: Integers, body: StepArrays) -> bool:
    """Return True if a critical part touches a forbidden surface or the head is behind the start."""
    for part in range(len(contacts)):
        if body.critical[part]:
            if contacts[part, 0] > 0:
                return True
            if contacts[part, 1] > 0 and not body.may_touch_ceiling:
                return True
    behind: bool = state[body.head, 0] < 0
    return behind


@kernel
def step_outcome(
    state: Floats, contacts: Integers, body: StepArrays, goal_x: float, cost: float, before: float
) -> tuple[float, bool, float]:
    """Return reward, termination and shaping potential after a step.

    The reward is the increase of the potential since `before`, minus the `cost` of torques, or FALL_REWARD.
    The episode ends beyond `goal_x`, without a bonus.
    """
    after = shaping(state, body)
    if has_fallen(state, contacts, body):
        return FALL_REWARD, True, after
    return after - before - cost, state[body.head, 0] > goal_x, after


DENSITY = 1.0  # density of water, in kg/m²
GRAVITY = 10.0  # gravitational acceleration of displaced water, in m/s²
DRAG, LARGEST_DRAG = 0.25, 2000.0  # coefficient, and upper bound in N
LIFT, LARGEST_LIFT = 0.25, 500.0  # coefficient, and upper bound in N
PUSH, LARGEST_PUSH = 0.05, 20.0  # coefficient, and upper bound of each component in N
TORQUE_SCALE = 60 / 50  # the original release computes torques for steps of 1/60 s instead of 1/50 s


@kernel
def water_forces(
    state: Floats, rotations: Floats, torques: Floats, body: StepArrays, water_y: float, forces: Floats
) -> bool:
    """Write the `forces` of still water on the parts, and return True if any part is submerged.

    These are a force on the centre of mass, x and y in N, and a torque about it in N m (p, 3). `torques` (j,)
    are those of the motors in the last step, in N m.
    """
    wet = False
    for part in range(len(state)):
        forces[part] = 0.0
        if state[part, 1] - body.bounds[part, 0] < water_y:
            polygon = _submerged(part, state[part], rotations[part], body, water_y)
            if len(polygon) > 2:
                wet = True
                _press(part, polygon, state, rotations, torques, body, forces[part])
    return wet


@kernel
def _submerged(part: int, pose: Floats, rotation: Floats, body: StepArrays, water_y: float) -> Floats:
    """Return the corners (k, 2) of the submerged area of a part, counter-clockwise, in world coordinates."""
    first, count = body.first_vertex[part], body.first_vertex[part + 1] - body.first_vertex[part]
    corners = np.empty((count, 2))
    for index in range(count):
        x, y = body.vertices[first + index, 0], body.vertices[first + index, 1]
        corners[index, 0] = pose[0] + rotation[0] * x - rotation[1] * y
        corners[index, 1] = pose[1] + rotation[1] * x + rotation[0] * y
    clipped, size = np.empty((count + 1, 2)), 0
    for index in range(count):
        start, end = corners[index], corners[(index + 1) % count]
        if start[1] <= water_y:
            clipped[size] = start
            size += 1
        if (start[1] <= water_y) != (end[1] <= water_y):
            share = (water_y - start[1]) / (end[1] - start[1])
            clipped[size, 0] = start[0] + share * (end[0] - start[0])
            clipped[size, 1] = water_y
            size += 1
    return clipped[:size]


@kernel
def _press(
    part: int,
    polygon: Floats,
    state: Floats,
    rotations: Floats,
    torques: Floats,
    body: StepArrays,
    force: Floats,
) -> None:
    """Add buoyancy, drag, lift and propulsion of a part's submerged `polygon` to `force` (3,)."""
    rotation = rotations[part]
    across, up = body.bounds[part, 2], body.bounds[part, 3]
    centre_x = state[part, 0] + rotation[0] * across - rotation[1] * up
    centre_y = state[part, 1] + rotation[1] * across + rotation[0] * up
    x, area = _centroid(polygon)
    force[1] += DENSITY * area * GRAVITY
    force[2] += (x - centre_x) * DENSITY * area * GRAVITY
    for index in range(len(polygon)):
        start, end = polygon[index], polygon[(index + 1) % len(polygon)]
        edge_x, edge_y = end[0] - start[0], end[1] - start[1]
        length = math.sqrt(edge_x * edge_x + edge_y * edge_y)
        if length > 0:
            edge_x, edge_y = edge_x / length, edge_y / length
            lever_x, lever_y = (start[0] + end[0]) / 2 - centre_x, (start[1] + end[1]) / 2 - centre_y
            _resist((edge_x, edge_y, length), (lever_x, lever_y), state[part], force)
            for joint in range(len(body.hinges)):
                if body.joint_parts[joint, 1] == part:
                    _push(joint, (edge_x, edge_y, length), state, rotation, torques[joint], body, force)


@kernel
def _centroid(polygon: Floats) -> tuple[float, float]:
    """Return the x of a polygon's centroid in m, and its area in m²."""
    base, area, moment = polygon[0], 0.0, 0.0
    for index in range(1, len(polygon) - 1):
        ax, ay = polygon[index, 0] - base[0], polygon[index, 1] - base[1]
        bx, by = polygon[index + 1, 0] - base[0], polygon[index + 1, 1] - base[1]
        wedge = (ax * by - ay * bx) / 2
        area += wedge
        moment += wedge * (ax + bx) / 3
    return (base[0] + moment / area if area > 0 else base[0]), area


@kernel
def _resist(
    edge: tuple[float, float, float], lever: tuple[float, float], motion: Floats, force: Floats
) -> None:
    """Add to `force` (3,) the drag and lift on an edge that moves outwards (paper).

    `edge` is direction and length, `lever` the middle of the edge relative to the centre of mass.
    """
    velocity_x, velocity_y = motion[3] - motion[5] * lever[1], motion[4] + motion[5] * lever[0]
    speed = math.sqrt(velocity_x * velocity_x + velocity_y * velocity_y)
    if speed == 0:
        return
    x, y = velocity_x / speed, velocity_y / speed
    outwards = edge[1] * x - edge[0] * y
    if outwards < 0:
        return
    pressure = outwards * edge[2] * DENSITY * speed * speed
    drag = min(DRAG * pressure, LARGEST_DRAG)
    lift = min(LIFT * pressure * (edge[0] * x + edge[1] * y), LARGEST_LIFT)
    _add(-drag * x - lift * y, -drag * y + lift * x, lever[0], lever[1], force)


@kernel
def _push(
    joint: int,
    edge: tuple[float, float, float],
    state: Floats,
    rotation: Floats,
    torque: float,
    body: StepArrays,
    force: Floats,
) -> None:
    """Add to `force` (3,) the push of an edge driven by the motor of `joint`, unless it is at a limit."""
    first, second = body.joint_parts[joint]
    hinge, motion = body.hinges[joint], state[second]
    if not hinge[2] < motion[2] - state[first, 2] < hinge[3]:
        return
    across, up = body.bounds[second, 2] - hinge[0], body.bounds[second, 3] - hinge[1]
    lever_x, lever_y = rotation[0] * across - rotation[1] * up, rotation[1] * across + rotation[0] * up
    turn = TORQUE_SCALE * torque
    pull_x, pull_y = -turn * lever_y, turn * lever_x
    outwards = edge[1] * pull_x - edge[0] * pull_y
    if outwards <= 0:
        return
    momentum = turn + body.bounds[second, 1] * motion[5]
    size = outwards * PUSH * edge[2] * DENSITY * momentum * momentum
    x = min(max(-size * pull_x, -LARGEST_PUSH), LARGEST_PUSH)
    y = min(max(-size * pull_y, -LARGEST_PUSH), LARGEST_PUSH)
    _add(x, y, -lever_x, -lever_y, force)


@kernel
def _add(x: float, y: float, lever_x: float, lever_y: float, force: Floats) -> None:
    """Add to `force` (3,) a force (x, y) applied at a lever from the centre of mass, and its torque."""
    force[0] += x
    force[1] += y
    force[2] += lever_x * y - lever_y * x

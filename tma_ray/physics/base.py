"""Protocol of the physics engines and the settings that they share."""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.embodiments import Embodiment
from tma_ray.physics.rules import StepArrays
from tma_ray.terrain import Terrain

PHYSICS_VERSION = 3  # raised by every change that affects trajectories; part of each run's identity

TIME_STEP = 1 / 50  # time between two actions, in s
GRAVITY = -10.0  # in m/s²
CEILING_TYPE = 1 << 20  # collision type of the ceiling's shapes
HANGING_STEPS = 6  # steps with closed grips before the episode of a hanging body; others take one step


class SolverSettings(NamedTuple):
    """Settings of Chipmunk's solver, chosen by the measurements in docs/fidelity.md."""

    iterations: int = 30  # solver iterations per substep
    substeps: int = 2  # substeps per time step
    # share, in (0, 1], of a time step's substeps in which the motors act, from the first one on. The torque
    # is divided by it, which keeps the largest impulse of a time step
    motor_share: float = 1.0
    joint_error_bias: float = 0.5**60  # share of a joint's error left after one second
    # highest speed back into a joint's limits, in rad/s. The joint keeps that speed in Chipmunk, so
    # that a high one would be a bounce, which Box2D's limits do not have
    limit_correction_speed: float = 0.1
    collision_bias: float = 0.5**60  # share of a penetration left after one second
    collision_slop: float = 0.005  # allowed penetration, in m
    skin_radius: float = 0.01  # rounding around every part, in m (as around Box2D's polygons)


def settings_for(body: Embodiment) -> SolverSettings:
    """Return the solver settings of `body`."""
    return SolverSettings(body.iterations, body.substeps, body.motor_share, (1 - body.joint_correction) ** 60)


def motor_substeps(settings: SolverSettings) -> int:
    """Return the number of substeps, at least 1, in which the motors act."""
    return max(1, round(settings.motor_share * settings.substeps))


class Engine(Protocol):
    """Simulation of one body in one world at a time.

    A step overwrites all arrays but the body's.

    Attributes:
        arrays: arrays of the body for the kernels.
        state: values (p, 6) in the layout of kernels.py.
        contacts: number of pieces of ground and of ceiling that each part touches (p, 2).
        grips: object that each grip sensor touches and holds (g, 2).
        medium: consecutive steps under water and outside it (2,).
    """

    arrays: StepArrays
    state: NDArray[np.float64]
    contacts: NDArray[np.int64]
    grips: NDArray[np.int64]
    medium: NDArray[np.int64]

    @property
    def creeper_poses(self) -> NDArray[np.float64]:
        """Each creeper's centre in m, cosine and sine of its angle (c, 4)."""
        ...

    def reset(self, terrain: Terrain, push: float) -> NDArray[np.float32]:
        """Build a new world, run a step without torque like the original release, and return the observation.

        Under a ceiling, a body with grip sensors starts hanging and runs HANGING_STEPS instead.

        Args:
            terrain: terrain of the world.
            push: horizontal force on the head during the first step, in N.
        """
        ...

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool]:
        """Advance the world by TIME_STEP, and return observation (o,), reward and termination.

        The action (j + g,) has one value in [-1, 1] per motor, then one per grip sensor.

        Raises:
            ValueError: if the action has another shape or is not finite.
        """
        ...


def first_steps(engine: Engine, hanging: bool) -> NDArray[np.float32]:
    """Run the steps that precede an episode, with closed grips if `hanging`, and return the observation (o,).

    They do not count as time in a medium.
    """
    motors, grips = len(engine.arrays.motors), len(engine.arrays.grips)
    action = np.zeros(motors + grips)
    if hanging:
        action[motors:] = 1.0
    for _ in range(HANGING_STEPS if hanging else 1):
        observation = engine.step(action)[0]
        engine.medium[:] = 0
    return observation

"""Interface of the physics engines, and their common settings."""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.embodiments import Embodiment
from tma_ray.physics.rules import StepArrays
from tma_ray.terrain import Terrain

PHYSICS_VERSION = 3  # part of each run's identity; increased by every change to trajectories

TIME_STEP = 1 / 50  # time between two actions, in s
GRAVITY = -10.0  # in m/s²
CEILING_TYPE = 1 << 20  # Chipmunk's collision type of ceiling shapes
HANGING_STEPS = 6  # steps with closed grips before episodes that start hanging; 1 step before others


class SolverSettings(NamedTuple):
    """Settings of Chipmunk's solver, based on measurements in docs/fidelity.md."""

    iterations: int = 30  # solver iterations per substep
    substeps: int = 2  # substeps per time step
    # share, in (0, 1], of the substeps in which motors act: the first ones of each time step. Torques are
    # divided by this share, so that the largest impulse per time step does not depend on it.
    motor_share: float = 1.0
    joint_error_bias: float = 0.5**60  # share of a joint's error left after one second
    # highest speed at which a joint is moved back into its limits, in rad/s: unlike in Box2D, the joint then
    # keeps this speed, so that a high one would make it bounce
    limit_correction_speed: float = 0.1
    collision_bias: float = 0.5**60  # share of a penetration left after one second
    collision_slop: float = 0.005  # allowed penetration, in m
    skin_radius: float = 0.01  # radius by which parts are rounded, in m (as for polygons in Box2D)


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
        state: state of the parts (p, 6), as in kernels.py.
        contacts: numbers of ground and of ceiling solids that each part touches (p, 2).
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
        """Poses of the creepers (c, 4), with x and y of the centre in m, cosine and sine of the angle."""
        ...

    def reset(self, terrain: Terrain, push: float) -> NDArray[np.float32]:
        """Build a new world, run the steps before an episode, and return the observation.

        This is one step without torque, as in the original release. Under a ceiling, a body with grip sensors
        starts hanging and runs HANGING_STEPS instead.

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
    """Run the steps before an episode, with closed grips if `hanging`, and return the observation (o,).

    These steps do not count as steps under or outside water.
    """
    motors, grips = len(engine.arrays.motors), len(engine.arrays.grips)
    action = np.zeros(motors + grips)
    if hanging:
        action[motors:] = 1.0
    for _ in range(HANGING_STEPS if hanging else 1):
        observation = engine.step(action)[0]
        engine.medium[:] = 0
    return observation

"""For authors of teachers: a contract to test against, and students that need no physics."""

from tma_ray.testing.conformance import TeacherConformance
from tma_ray.testing.simulation import EPISODES, SimulatedRun, Simulation, simulate
from tma_ray.testing.students import (
    SIMULATED_CHALLENGES,
    SimulatedChallenge,
    SimulatedStudent,
    StudentParameters,
    find_simulated_challenge,
)
from tma_ray.testing.trials import Scenario, TrialStudent

__all__ = [
    "EPISODES",
    "SIMULATED_CHALLENGES",
    "Scenario",
    "SimulatedChallenge",
    "SimulatedRun",
    "SimulatedStudent",
    "Simulation",
    "StudentParameters",
    "TeacherConformance",
    "TrialStudent",
    "find_simulated_challenge",
    "simulate",
]

"""For authors of teachers: a contract to test against, and students that need no physics."""

from tma_ray.testing.challenges import SIMULATED_CHALLENGES, SimulatedChallenge, find_simulated_challenge
from tma_ray.testing.conformance import TeacherConformance
from tma_ray.testing.playing import Scenario, TrialStudent
from tma_ray.testing.simulation import EPISODES, SimulatedRun, Simulation, simulate
from tma_ray.testing.students import SimulatedStudent, StudentParameters

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

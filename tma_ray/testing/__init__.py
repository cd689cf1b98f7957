"""For authors of teachers: a contract to test against, and students that need no physics."""

from tma_ray.testing.challenges import SIMULATED_CHALLENGES, SimulatedChallenge, find_simulated_challenge
from tma_ray.testing.conformance import TeacherConformance
from tma_ray.testing.playing import Pupil, Scenario
from tma_ray.testing.simulation import EPISODES, SimulatedRun, Simulation, simulate
from tma_ray.testing.students import Aptitude, SimulatedStudent

__all__ = [
    "EPISODES",
    "SIMULATED_CHALLENGES",
    "Aptitude",
    "Pupil",
    "Scenario",
    "SimulatedChallenge",
    "SimulatedRun",
    "SimulatedStudent",
    "Simulation",
    "TeacherConformance",
    "find_simulated_challenge",
    "simulate",
]

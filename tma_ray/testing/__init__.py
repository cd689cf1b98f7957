"""Tools for authors of teachers: conformance tests and simulated students without physics."""

from tma_ray.testing.conformance import TeacherConformance
from tma_ray.testing.scenarios import Scenario, ScriptedStudent
from tma_ray.testing.simulation import EPISODES, SimulatedRun, Simulation, simulate
from tma_ray.testing.students import (
    SIMULATED_CHALLENGES,
    SimulatedChallenge,
    SimulatedStudent,
    StudentParameters,
    find_simulated_challenge,
)

__all__ = [
    "EPISODES",
    "SIMULATED_CHALLENGES",
    "Scenario",
    "ScriptedStudent",
    "SimulatedChallenge",
    "SimulatedRun",
    "SimulatedStudent",
    "Simulation",
    "StudentParameters",
    "TeacherConformance",
    "find_simulated_challenge",
    "simulate",
]

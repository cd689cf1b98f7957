"""Contracts of teachers, students, environments and bodies, as tests that their authors inherit."""

from tma_ray.conformance.bodies import BodyConformance
from tma_ray.conformance.environments import EnvironmentConformance
from tma_ray.conformance.students import StudentConformance
from tma_ray.testing import TeacherConformance

__all__ = ["BodyConformance", "EnvironmentConformance", "StudentConformance", "TeacherConformance"]

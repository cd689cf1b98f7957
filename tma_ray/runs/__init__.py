"""Execution of single training runs, without Ray, with evaluations and checkpoints."""

from tma_ray.runs.attempt import Attempt, run_locally
from tma_ray.runs.cell import Cell, effective_spec
from tma_ray.runs.checkpoints import Checkpoints
from tma_ray.runs.placement import Placement, Status
from tma_ray.runs.run import Run
from tma_ray.runs.spec import Plugin, RunSpec, Schedule
from tma_ray.runs.teaching import InlineTeacher, Reply, TeacherLink

__all__ = [
    "Attempt",
    "Cell",
    "Checkpoints",
    "InlineTeacher",
    "Placement",
    "Plugin",
    "Reply",
    "Run",
    "RunSpec",
    "Schedule",
    "Status",
    "TeacherLink",
    "effective_spec",
    "run_locally",
]

"""Every teacher of the catalogue keeps the contract of the conformance kit."""

from __future__ import annotations

from typing import Any

from tma_ray.teachers import TEACHERS
from tma_ray.testing import TeacherConformance

SMALLER: dict[str, dict[str, Any]] = {
    "alp_gmm": {"most_components": 5},
    "covar_gmm": {"most_components": 5},
    "goal_gan": {"pretraining_iterations": 20, "iterations_per_task": 0.25},
    "setter_solver": {"hidden_units": 16},
}
"""Where the defaults take longest."""

for _name in TEACHERS.names():
    _members = {"teacher": TEACHERS.get(_name), "hyperparameters": SMALLER.get(_name, {})}
    globals()[f"Test_{_name}"] = type(f"Test_{_name}", (TeacherConformance,), _members)

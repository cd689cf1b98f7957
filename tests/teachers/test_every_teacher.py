"""Every teacher of the catalogue keeps the contract of the conformance kit."""

from __future__ import annotations

from tma_ray.teachers import TEACHERS
from tma_ray.testing import TeacherConformance

for _name in TEACHERS.names():
    globals()[f"Test_{_name}"] = type(
        f"Test_{_name}", (TeacherConformance,), {"teacher": TEACHERS.get(_name)}
    )

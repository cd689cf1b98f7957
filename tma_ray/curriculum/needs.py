"""Needs of teachers: the functions that a training loop provides."""

import pandas as pd

from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers import TEACHERS, Teacher


def needs_of(teacher: type[Teacher]) -> list[str]:
    """Return the arguments of a `Curriculum` without which a teacher cannot teach."""
    evaluates = teacher.wants_evaluations and not teacher.withholds_episodes
    needed = {"values": teacher.wants_values, "act": teacher.withholds_episodes, "evaluate": evaluates}
    return [name for name, needs in needed.items() if needs]


def teacher_needs() -> pd.DataFrame:
    """Return what each teacher needs of a training loop.

    Returns:
        Columns ``teacher``, ``needs`` (arguments of `Curriculum`), ``expert_knowledge`` (the least level)
        and ``several_worlds`` (True if it teaches worlds whose episodes overlap).
    """
    rows = []
    for name in TEACHERS.names():
        teacher = TEACHERS.get(name)
        least: KnowledgeLevel = teacher.knowledge_levels[0]
        rows.append((name, ", ".join(needs_of(teacher)), least.value, teacher.overlapping))
    return pd.DataFrame(rows, columns=["teacher", "needs", "expert_knowledge", "several_worlds"])


def without_needs() -> list[str]:
    """Return the names of the teachers that every loop can have."""
    return [name for name in TEACHERS.names() if not needs_of(TEACHERS.get(name))]

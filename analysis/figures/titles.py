"""What figures call challenges, levels and bodies."""

from __future__ import annotations

from tma_ray.benchmark import CHALLENGES
from tma_ray.tasks import KnowledgeLevel


def title(column: str, value: object) -> str:
    """Returns a value of a column of result tables as panels are headed: ``Mostly unfeasible``."""
    if column == "expert_knowledge":
        return f"{'no' if value == KnowledgeLevel.NONE else value} expert knowledge".capitalize()
    if column == "challenge":
        titles = {challenge.title for challenge in CHALLENGES if challenge.name == value}
        if len(titles) == 1:  # several environments have an "original"
            return titles.pop()
    names = value if isinstance(value, tuple) else (value,)
    return ", ".join(str(name) for name in names).replace("_", " ").capitalize()


def order(column: str, value: object) -> tuple[int, str]:
    """Sorts such values: challenges as the benchmark lists them, levels by rank, the rest by name."""
    known: list[object] = []
    if column == "expert_knowledge":
        known = [level.value for level in KnowledgeLevel]
    elif column == "challenge":
        known = [challenge.name for challenge in CHALLENGES]
    return (known.index(value) if value in known else len(known), str(value))

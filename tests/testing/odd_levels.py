"""A teacher outside the catalogue that cannot do without a mastery threshold, and uses no more."""

from __future__ import annotations

from dataclasses import dataclass

from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers.random import Random


@dataclass
class NeedsLow(Random):
    knowledge_levels = (KnowledgeLevel.LOW,)

"""Teacher outside the catalogue that requires exactly a mastery threshold."""

from dataclasses import dataclass

from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers.random import Random


@dataclass
class NeedsLow(Random):
    knowledge_levels = (KnowledgeLevel.LOW,)

"""The language all parts share: task spaces, test sets, expert knowledge, episodes."""

from tma_ray.tasks.episode import (
    MASTERY_RETURN,
    Episode,
    Proposal,
    ScoredBox,
    TeacherUpdate,
    WeightedGaussian,
)
from tma_ray.tasks.knowledge import ExpertKnowledge, Gaussian, KnowledgeLevel, expert_knowledge
from tma_ray.tasks.queries import Answer, Outcomes, Query, QueryKind, Trajectory
from tma_ray.tasks.shuffled_space import ShuffledSpace
from tma_ray.tasks.space import Dimension, Task, TaskSpace, check_task
from tma_ray.tasks.test_set import TestSet

__all__ = [
    "MASTERY_RETURN",
    "Answer",
    "Dimension",
    "Episode",
    "ExpertKnowledge",
    "Gaussian",
    "KnowledgeLevel",
    "Outcomes",
    "Proposal",
    "Query",
    "QueryKind",
    "ScoredBox",
    "ShuffledSpace",
    "Task",
    "TaskSpace",
    "TeacherUpdate",
    "TestSet",
    "Trajectory",
    "WeightedGaussian",
    "check_task",
    "expert_knowledge",
]

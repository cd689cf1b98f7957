"""Types shared by all packages: task spaces, test sets, expert knowledge, episodes."""

from tma_ray.tasks.episodes import (
    Answer,
    Episode,
    EpisodeSoFar,
    Outcomes,
    Proposal,
    Query,
    QueryKind,
    Recorder,
    ScoredBox,
    TeacherUpdate,
    Trajectory,
    WeightedGaussian,
    check_return,
)
from tma_ray.tasks.knowledge import (
    MASTERY_RETURN,
    ExpertKnowledge,
    Gaussian,
    KnowledgeLevel,
    TestSet,
    expert_knowledge,
)
from tma_ray.tasks.spaces import Dimension, ShuffledSpace, Task, TaskSpace, check_task, task_values

__all__ = [
    "MASTERY_RETURN",
    "Answer",
    "Dimension",
    "Episode",
    "EpisodeSoFar",
    "ExpertKnowledge",
    "Gaussian",
    "KnowledgeLevel",
    "Outcomes",
    "Proposal",
    "Query",
    "QueryKind",
    "Recorder",
    "ScoredBox",
    "ShuffledSpace",
    "Task",
    "TaskSpace",
    "TeacherUpdate",
    "TestSet",
    "Trajectory",
    "WeightedGaussian",
    "check_return",
    "check_task",
    "expert_knowledge",
    "task_values",
]

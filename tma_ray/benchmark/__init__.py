"""The benchmark as data: challenges, test sets, experiments, knowledge requirements, the paper's results."""

from tma_ray.benchmark.challenges import (
    CHALLENGES,
    Challenge,
    challenges_of,
    find_challenge,
    load_test_set,
    shipped_test_sets,
)
from tma_ray.benchmark.experiments import EXPERIMENTS, TEACHERS, Experiment, find_experiment
from tma_ray.benchmark.grids import PPO_GRID, TEACHER_GRIDS, Grid
from tma_ray.benchmark.knowledge_requirements import (
    KNOWLEDGE_REQUIREMENTS,
    KnowledgeRequirements,
    Requirement,
)
from tma_ray.benchmark.matrices import (
    CASE_STUDIES,
    MATRICES,
    ORIGINAL_SPACE,
    PARKOUR,
    STUMP_TRACKS_CHALLENGES,
    Matrix,
    select,
)
from tma_ray.benchmark.paper import PaperResult, paper_results
from tma_ray.benchmark.tiers import SIZES, Size, Tier
from tma_ray.benchmark.version import BENCHMARK_VERSION

__all__ = [
    "BENCHMARK_VERSION",
    "CASE_STUDIES",
    "CHALLENGES",
    "EXPERIMENTS",
    "KNOWLEDGE_REQUIREMENTS",
    "MATRICES",
    "ORIGINAL_SPACE",
    "PARKOUR",
    "PPO_GRID",
    "SIZES",
    "STUMP_TRACKS_CHALLENGES",
    "TEACHERS",
    "TEACHER_GRIDS",
    "Challenge",
    "Experiment",
    "Grid",
    "KnowledgeRequirements",
    "Matrix",
    "PaperResult",
    "Requirement",
    "Size",
    "Tier",
    "challenges_of",
    "find_challenge",
    "find_experiment",
    "load_test_set",
    "paper_results",
    "select",
    "shipped_test_sets",
]

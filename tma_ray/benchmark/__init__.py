"""Data of the benchmark: challenges, test sets, experiments, knowledge requirements, the paper's results."""

from typing import Final

from tma_ray.benchmark.challenges import (
    CHALLENGES,
    Challenge,
    challenges_of,
    find_challenge,
    load_test_set,
    shipped_test_sets,
    thinned,
)
from tma_ray.benchmark.experiments import (
    EXPERIMENTS,
    SIZES,
    TEACHERS,
    Experiment,
    Size,
    Tier,
    find_experiment,
)
from tma_ray.benchmark.matrices import (
    CASE_STUDIES,
    MATRICES,
    ORIGINAL_SPACE,
    PARKOUR,
    PPO_GRID,
    STUMP_TRACKS_CHALLENGES,
    TEACHER_GRIDS,
    Grid,
    Matrix,
    select,
)
from tma_ray.benchmark.paper import (
    KNOWLEDGE_REQUIREMENTS,
    PAPER_STEPS,
    KnowledgeRequirements,
    PaperResult,
    Requirement,
    paper_results,
)

BENCHMARK_VERSION: Final = 1
"""Version of the benchmark, raised with the version of the physics, of the results' schema, or of any
built-in teacher, student or environment, as a test checks. Runs and releases record it; older runs have 0."""

__all__ = [
    "BENCHMARK_VERSION",
    "CASE_STUDIES",
    "CHALLENGES",
    "EXPERIMENTS",
    "KNOWLEDGE_REQUIREMENTS",
    "MATRICES",
    "ORIGINAL_SPACE",
    "PAPER_STEPS",
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
    "thinned",
]

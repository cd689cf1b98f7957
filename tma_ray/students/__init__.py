"""Students: deep-RL algorithms built on stable-baselines3.

Names are imported on first use, and none of them imports torch.
"""

from typing import TYPE_CHECKING

from tma_ray.support.lazy_imports import attach

if TYPE_CHECKING:
    from tma_ray.students.base import Policy, Student, Transition
    from tma_ray.students.catalogue import (
        COHORT_STUDENTS,
        STUDENTS,
        canonical_student,
        check_hyperparameters,
        default_hyperparameters,
        load_policy,
        make_rollout_worker,
        make_student,
        policy_layers,
    )
    from tma_ray.students.hyperparameters import PPOHyperparameters, SACHyperparameters
    from tma_ray.students.policy_files import PolicyFileError, StoredPolicy, read_policy, write_policy
    from tma_ray.students.rollout_workers.link import Learner

__all__ = [
    "COHORT_STUDENTS",
    "STUDENTS",
    "Learner",
    "PPOHyperparameters",
    "Policy",
    "PolicyFileError",
    "SACHyperparameters",
    "StoredPolicy",
    "Student",
    "Transition",
    "canonical_student",
    "check_hyperparameters",
    "default_hyperparameters",
    "load_policy",
    "make_rollout_worker",
    "make_student",
    "policy_layers",
    "read_policy",
    "write_policy",
]

__getattr__, __dir__ = attach(__name__, __file__)

"""Students: deep-RL algorithms over stable-baselines3. Importing this package does not import torch."""

from tma_ray.students.base import Policy, Student, Transition
from tma_ray.students.catalogue import (
    STUDENTS,
    canonical_student,
    check_hyperparameters,
    default_hyperparameters,
    load_policy,
    make_student,
    policy_layers,
)
from tma_ray.students.hyperparameters import PPOHyperparameters, SACHyperparameters
from tma_ray.students.players import Learner, make_player
from tma_ray.students.policy_files import PolicyFileError, StoredPolicy, read_policy, write_policy

__all__ = [
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
    "make_player",
    "make_student",
    "policy_layers",
    "read_policy",
    "write_policy",
]

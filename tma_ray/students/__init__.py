"""Students: deep-RL algorithms over stable-baselines3. Importing this package does not import torch."""

from tma_ray.students.base import Policy, Student, Transition
from tma_ray.students.catalogue import (
    STUDENTS,
    check_hyperparameters,
    default_hyperparameters,
    load_policy,
    make_student,
)
from tma_ray.students.hyperparameters import PPOHyperparameters, SACHyperparameters

__all__ = [
    "STUDENTS",
    "PPOHyperparameters",
    "Policy",
    "SACHyperparameters",
    "Student",
    "Transition",
    "check_hyperparameters",
    "default_hyperparameters",
    "load_policy",
    "make_student",
]

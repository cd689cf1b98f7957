"""Registry of teachers."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from tma_ray.components.registry import Registry
from tma_ray.components.settings import config_dict, non_defaults, parse_settings
from tma_ray.support.component_names import base_name, join_name, split_name
from tma_ray.tasks import KnowledgeLevel, TaskSpace
from tma_ray.teachers.base import Teacher

TEACHERS: Registry[type[Teacher]] = Registry(
    "teacher",
    "tma_ray.teachers",
    {
        "random": "tma_ray.teachers.random:Random",
        "accel": "tma_ray.teachers.accel:ACCEL",
        "adr": "tma_ray.teachers.adr:ADR",
        "alp_gmm": "tma_ray.teachers.alp_gmm:ALPGMM",
        "covar_gmm": "tma_ray.teachers.covar_gmm:CovarGMM",
        "currot": "tma_ray.teachers.currot:CURROT",
        "doraemon": "tma_ray.teachers.doraemon:DORAEMON",
        "goal_gan": "tma_ray.teachers.goal_gan:GoalGAN",
        "lp_acrl": "tma_ray.teachers.lp_acrl:LPACRL",
        "perm": "tma_ray.teachers.perm:PERM",
        "plr": "tma_ray.teachers.plr:PLR",
        "procurl_target": "tma_ray.teachers.procurl_target:ProCuRLTarget",
        "ramp": "tma_ray.teachers.ramp:Ramp",
        "riac": "tma_ray.teachers.riac:RIAC",
        "robust_plr": "tma_ray.teachers.plr:RobustPLR",
        "sfl": "tma_ray.teachers.sfl:SFL",
        "setter_solver": "tma_ray.teachers.setter_solver:SetterSolver",
        "sobol": "tma_ray.teachers.sobol:Sobol",
        "spdl": "tma_ray.teachers.spdl:SPDL",
        "spgl": "tma_ray.teachers.spgl:SPGL",
        "traced": "tma_ray.teachers.traced:TRACED",
    },
    Teacher,
)

TeacherType = TypeVar("TeacherType", bound=type[Teacher])


def register_teacher(name: str) -> Callable[[TeacherType], TeacherType]:
    """Return a decorator that registers a `Teacher` under `name`."""
    return TEACHERS.register(name)


def make_teacher(name: str, hyperparameters: Mapping[str, Any] | None = None) -> Teacher:
    """Return a new teacher called `name`, not yet started.

    Args:
        name: registered name or ``module:Name``, with optional hyper-parameters
            (``alp_gmm:fit_every=100``), among them ``preset=`` if the teacher has presets.
        hyperparameters: further hyper-parameters.

    Raises:
        UnknownNameError: if the teacher is unknown.
        ValueError: if a hyper-parameter or preset is unknown or invalid.
    """
    base, settings = split_name(name)
    teacher = TEACHERS.get(base)
    try:
        return teacher(**parse_settings(teacher, settings, hyperparameters))
    except ValueError as error:
        raise ValueError(f"teacher {base!r}: {error}") from error


def canonical_teacher(name: str, hyperparameters: Mapping[str, Any] | None = None) -> str:
    """Return the name of a teacher followed by the hyper-parameters that differ from its defaults.

    Equal teachers have equal names. Arguments and errors are those of `make_teacher`.
    """
    teacher = make_teacher(name, hyperparameters)
    return join_name(base_name(name), non_defaults(type(teacher), hyperparameters_of(teacher)))


def hyperparameters_of(teacher: Teacher) -> dict[str, Any]:
    """Return all hyper-parameters of `teacher` by name, as JSON values."""
    return config_dict(teacher)


def knows_enough(teacher: type[Teacher], level: KnowledgeLevel) -> bool:
    """Return True if the knowledge at `level` is sufficient for `teacher`."""
    return teacher.knowledge_levels[0].rank <= level.rank


def check_limits(teacher: type[Teacher], name: str, space: TaskSpace) -> None:
    """Check that `teacher` supports the task space `space`.

    Raises:
        ValueError: if it has too many dimensions, a constant one, or a single task.
    """
    if refusal := teacher.refusal(space):
        raise ValueError(f"teacher {name!r}: {refusal}; choose another teacher, or another challenge")


def effective_level(teacher: type[Teacher], name: str, level: KnowledgeLevel) -> KnowledgeLevel:
    """Return the highest knowledge level that `teacher` distinguishes, up to `level`.

    Raises:
        ValueError: if `teacher` needs a higher level.
    """
    level = KnowledgeLevel(level)
    if not knows_enough(teacher, level):
        needed = teacher.knowledge_levels[0]
        raise ValueError(
            f"teacher {name!r} cannot run with expert knowledge {level.value!r}: "
            f"it needs at least {needed.value!r}"
        )
    usable = (candidate for candidate in teacher.knowledge_levels if candidate.rank <= level.rank)
    return max(usable, key=lambda candidate: candidate.rank)

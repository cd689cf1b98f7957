"""Labels and order of everything that is shown: teachers, challenges, levels and bodies."""

from __future__ import annotations

from collections.abc import Mapping

from tma_ray.benchmark import CHALLENGES, challenges_of
from tma_ray.hyperparameters import PRESET
from tma_ray.part_names import split_name
from tma_ray.tasks import KnowledgeLevel

_LABELS = {
    "random": "Random",
    "adr": "ADR",
    "alpgmm": "ALP-GMM",
    "covargmm": "Covar-GMM",
    "goalgan": "GoalGAN",
    "riac": "RIAC",
    "settersolver": "Setter-Solver",
    "spdl": "SPDL",
}


def label(teacher: str) -> str:
    """Returns the name of a teacher as the paper prints it, or the plug-in's own, with its settings.

    Examples:
        >>> label("alp_gmm"), label("alp_gmm:fit_every=100"), label("goal_gan:preset=release")
        ('ALP-GMM', 'ALP-GMM (fit_every=100)', 'GoalGAN (release)')
    """
    name, settings = split_name(teacher)
    return with_settings(_LABELS.get(plain_name(name), name), settings)


def with_settings(name: str, settings: Mapping[str, str]) -> str:
    """Returns `name` with settings in brackets; a preset stands for itself."""
    shown = [value if key == PRESET else f"{key}={value}" for key, value in settings.items()]
    return f"{name} ({', '.join(shown)})" if shown else name


def challenge_title(environment: str, challenge: str, otherwise: str) -> str:
    """Returns the title of a challenge of the benchmark, with its settings; `otherwise` of somebody else's.

    Examples:
        >>> challenge_title("parkour:swinging_creepers=true", "easy", "")
        'Parkour, easy task space (swinging_creepers=true)'
    """
    name, bounds = split_name(challenge)
    known = challenges_of(environment).get(name)
    return with_settings(known.title, split_name(environment)[1] | bounds) if known else otherwise


def short_label(teacher: str, length: int = 18) -> str:
    """Returns `label`, cut to `length` characters where a figure has no room for more."""
    name = label(teacher)
    return name if len(name) <= length else f"{name[: length - 1]}…"


def teacher_order(teacher: str) -> tuple[bool, str]:
    """Sorts teachers: Random first, since the others are read against it, then by name."""
    return (plain_name(teacher) != "random", label(teacher).lower())


def plain_name(teacher: str) -> str:
    """Returns the letters and digits of a name in lower case: ``alpgmm`` for ALP-GMM and alp_gmm."""
    return "".join(character for character in teacher.lower() if character.isalnum())


def title(column: str, value: object) -> str:
    """Returns a value of a column of result tables as panels are headed: ``Mostly unfeasible``."""
    if column == "expert_knowledge":
        return f"{'no' if value == KnowledgeLevel.NONE else value} expert knowledge".capitalize()
    if column == "challenge":
        titles = {challenge.title for challenge in CHALLENGES if challenge.name == value}
        if len(titles) == 1:  # several environments have an "original"
            return titles.pop()
    names = value if isinstance(value, tuple) else (value,)
    return ", ".join(str(name) for name in names).replace("_", " ").capitalize()


def order(column: str, value: object) -> tuple[int, str]:
    """Sorts such values: challenges as the benchmark lists them, levels by rank, the rest by name."""
    known: list[object] = []
    if column == "expert_knowledge":
        known = [level.value for level in KnowledgeLevel]
    elif column == "challenge":
        known = [challenge.name for challenge in CHALLENGES]
    return (known.index(value) if value in known else len(known), str(value))

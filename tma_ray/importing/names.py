"""The experiment that a folder of the original release belongs to, read from its name."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

TEACHERS: Final = {
    "Random": "random",
    "ADR": "adr",
    "ALP-GMM": "alp_gmm",
    "Covar-GMM": "covar_gmm",
    "RIAC": "riac",
    "GoalGAN": "goal_gan",
    "Self-Paced": "spdl",
    "Setter-Solver": "setter_solver",
}
"""Our names by the original's."""

CRITERIA: Final = (
    "mostly_unfeasible",
    "mostly_trivial",
    "forgetting_student",
    "rugged_difficulty",
    "diverse_students",
)
"""Names of the challenges that the original counts from 1."""

BODIES: Final = {
    "old_classic_bipedal": "old_classic_bipedal",
    "classic_bipedal": "classic_bipedal",
    "small_bipedal": "short_bipedal",
    "short_bipedal": "short_bipedal",
    "big_quadru": "quadrupedal",
    "old_big_quadru": "old_quadrupedal",
    "spider": "spider",
    "millipede": "millipede",
    "wheel": "wheel",
    "profile_chimpanzee": "walking_chimpanzee",
    "fish": "fish",
    "climbing_profile_chimpanzee": "climbing_chimpanzee",
    "climbing_chest_profile_chimpanzee": "climbing_chest_chimpanzee",
    "amphibious_bipedal": "amphibious_bipedal",
}
"""Our names by the original's."""

DEFAULT_BODY: Final = "old_classic_bipedal"
"""Body of folders that name none: the original's launch files run it wherever the paper says bipedal."""

LEVELS: Final = {
    "no": "none",
    "minimal": "low",
    "low": "low",
    "maximal": "high",
    "high": "high",
}
"""Levels of expert knowledge by the original's names, older and newer."""

WITHOUT_KNOWLEDGE: Final = ("random",)
"""Teachers whose result at one level is their result at all."""

_END: Final = r"(?=_|$)"
_UPPER_BASELINE: Final = "UPPER_BASELINE"


class UnknownNameError(ValueError):
    """A folder name that does not say what its seeds are of; the message says what is missing."""


@dataclass(frozen=True)
class OriginalExperiment:
    """An experiment of the original: everything of a cell but the student, which the seed's files tell.

    Attributes:
        environment: our name.
        challenge: our name; original for an upper baseline.
        embodiment: our name.
        original_embodiment: its name in the original, empty where the folder does not say.
        teacher: our name.
        level: of expert knowledge, our name.
        student: as the folder has it, in small letters; empty where it does not say.
    """

    environment: str
    challenge: str
    embodiment: str
    original_embodiment: str
    teacher: str
    level: str
    student: str

    @property
    def place(self) -> tuple[str, str]:
        """Environment and challenge."""
        return self.environment, self.challenge


def parse(name: str) -> OriginalExperiment:
    """Returns what a folder name says.

    Args:
        name: as in ``05-03_profiling_benchmark_stumps_ALP-GMM_criteria_1_allow_expert_knowledge_no``; the
            parts may come in any order, and any others between them.

    Raises:
        UnknownNameError: something is missing, or not a name of the original.

    Examples:
        >>> parse("01-02_benchmark_parkour_RIAC_walker_type_fish").embodiment
        'fish'
    """
    environment = _environment(name)
    teacher = _named(name, "", TEACHERS, "teacher")
    if not teacher:
        raise UnknownNameError(f"no teacher in it: expected one of {', '.join(TEACHERS)}")
    body = _value(name, "walker_type", BODIES)
    challenge = _challenge(name, environment)
    if not body and (environment == "parkour" or challenge == "diverse_students"):
        raise UnknownNameError("no body in it: expected walker_type_ and its name")
    return OriginalExperiment(
        environment=environment,
        challenge=challenge,
        embodiment=BODIES[body] if body else DEFAULT_BODY,
        original_embodiment=body,
        teacher=TEACHERS[teacher],
        level=_level(name, environment, TEACHERS[teacher]),
        student=_student(name),
    )


def is_named(name: str) -> bool:
    """Tells whether a folder name is meant to say what its seeds are of."""
    return bool(re.search(r"stumps|parkour", name)) and any(
        re.search(_pattern("", teacher), name) for teacher in TEACHERS
    )


def _environment(name: str) -> str:
    found = [ours for theirs, ours in (("stumps", "stump_tracks"), ("parkour", "parkour")) if theirs in name]
    if len(found) != 1:
        raise UnknownNameError("no environment in it: expected stumps or parkour")
    return found[0]


def _challenge(name: str, environment: str) -> str:
    if environment == "parkour" or _UPPER_BASELINE in name:
        return "original"
    found = re.search(rf"criteria_(\d+){_END}", name)
    if found is None or not 1 <= int(found[1]) <= len(CRITERIA):
        raise UnknownNameError("no challenge in it: expected criteria_1 to criteria_5, or UPPER_BASELINE")
    return CRITERIA[int(found[1]) - 1]


def _level(name: str, environment: str, teacher: str) -> str:
    level = _value(name, "allow_expert_knowledge", LEVELS)
    if level:
        return LEVELS[level]
    if environment == "parkour":  # the paper has Parkour at this level alone
        return "low"
    if teacher in WITHOUT_KNOWLEDGE:
        return "none"
    raise UnknownNameError(
        "no level of expert knowledge in it: expected allow_expert_knowledge_no, _minimal or _maximal"
    )


def _student(name: str) -> str:
    found = re.search(r"_student_([0-9A-Za-z.-]+)", name)
    return found[1].lower() if found else ""


def _value(name: str, key: str, known: Mapping[str, str]) -> str:
    """Returns what stands after `key` if it is known, and nothing if `key` is not there."""
    if key not in name:
        return ""
    value = _named(name, f"{key}_", known, key)
    if not value:
        raise UnknownNameError(f"{key} is none of {', '.join(known)}")
    return value


def _named(name: str, before: str, known: Mapping[str, str], what: str) -> str:
    found = [value for value in known if re.search(_pattern(before, value), name)]
    if len(found) > 1:
        raise UnknownNameError(f"{what} is there more than once: {', '.join(found)}")
    return found[0] if found else ""


def _pattern(before: str, value: str) -> str:
    return rf"(?:^|_){re.escape(before + value)}{_END}"

"""Labels and order of teachers, environments, challenges, levels and bodies in tables and charts."""

import hashlib
import itertools
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache

from tma_ray.benchmark import CHALLENGES, challenges_of
from tma_ray.components.settings import PRESET
from tma_ray.support.component_names import join_name, split_name
from tma_ray.support.texts import visible
from tma_ray.tasks import KnowledgeLevel

MAX_LABEL_CHARS = 80
"""Largest number of characters of a name in sentences and tables."""

YOURS = " \N{LEFTWARDS ARROW} yours"
"""Suffix of the name of a reader's own teacher."""

_OWN: ContextVar[frozenset[str]] = ContextVar("own", default=frozenset())

_LABELS = {
    "random": "Random",
    "accel": "ACCEL",
    "adr": "ADR",
    "alpgmm": "ALP-GMM",
    "covargmm": "Covar-GMM",
    "currot": "CURROT",
    "doraemon": "DORAEMON",
    "goalgan": "GoalGAN",
    "lpacrl": "LP-ACRL",
    "parkour": "Parkour",
    "perm": "PERM",
    "plr": "PLR",
    "ppo": "PPO",
    "procurltarget": "ProCuRL-Target",
    "ramp": "Ramp",
    "riac": "RIAC",
    "robustplr": "Robust PLR",
    "sac": "SAC",
    "settersolver": "Setter-Solver",
    "sfl": "SFL",
    "sobol": "Sobol",
    "spdl": "SPDL",
    "spgl": "SPGL",
    "stumptracks": "Stump Tracks",
    "traced": "TRACED",
}


@cache
def label(part: str) -> str:
    """Return the display name of a teacher, student or environment, with its settings.

    A name longer than `MAX_LABEL_CHARS` is cut in the middle, and four digits of its hash keep it distinct.

    Examples:
        >>> label("alp_gmm"), label("alp_gmm:fit_every=100"), label("ppo:preset=decisive")
        ('ALP-GMM', 'ALP-GMM (fit_every=100)', 'PPO (decisive)')
    """
    name, settings = split_name(part)
    full = visible(with_settings(_LABELS.get(plain_name(name), name), settings))
    if len(full) <= MAX_LABEL_CHARS:
        return full
    digest = hashlib.sha256(part.encode()).hexdigest()[:4]
    return f"{full[: MAX_LABEL_CHARS - 27]}…{full[-20:]} [{digest}]"


@contextmanager
def own_first(teachers: Iterable[str]) -> Iterator[None]:
    """Context manager that marks `teachers` as the reader's own and sorts them first.

    `marked_label` and `short_labels` add the mark; `label`, for sentences, does not.
    """
    token = _OWN.set(frozenset(teachers))
    try:
        yield
    finally:
        _OWN.reset(token)


def marked_label(teacher: str) -> str:
    """Return the label of a teacher, with a mark if it is the reader's own (see `own_first`)."""
    return label(teacher) + mark_of(teacher)


def mark_of(teacher: str) -> str:
    """Return the mark of the reader's own teachers (see `own_first`), or an empty string for others."""
    return YOURS if teacher in _OWN.get() else ""


def with_settings(name: str, settings: Mapping[str, str]) -> str:
    """Return a name with its settings in brackets: ``name (preset, key=value)``."""
    shown = [value if key == PRESET else f"{key}={value}" for key, value in settings.items()]
    return f"{name} ({', '.join(shown)})" if shown else name


@cache
def challenge_title(environment: str, challenge: str, otherwise: str | None = None) -> str:
    """Return the title of a benchmark challenge with its settings; for others, `otherwise` or both names.

    Examples:
        >>> challenge_title("parkour:swinging_creepers=true", "easy", "")
        'Parkour, easy task space (swinging_creepers=true)'
    """
    name, bounds = split_name(challenge)
    shipped = challenges_of(environment).get(name)
    if shipped is None:
        return f"{environment} {challenge}" if otherwise is None else otherwise
    return with_settings(shipped.title, split_name(environment)[1] | bounds)


def short_title(title: str) -> str:
    """Return the title of a challenge without "Stump Tracks" and "task space"."""
    return title.removeprefix("Stump Tracks, ").removesuffix(" task space")


def short_labels(teachers: Iterable[str], length: int = 22) -> dict[str, str]:
    """Return distinct labels of teachers, short enough for a figure, sorted by `teacher_order`.

    A long name is cut to its beginning, or if that is not distinct, to its beginning and end, or else gets a
    number.

    Args:
        teachers: names of all teachers that are shown together.
        length: largest number of characters without the number and the mark of `own_first`.

    Examples:
        >>> list(short_labels(["my_teacher:fit_every=100", "my_teacher:fit_every=250"], 16).values())
        ['my_teac…ery=100)', 'my_teac…ery=250)']
    """
    labels = {teacher: label(teacher) for teacher in sorted(set(teachers))}
    room = length - 1
    ways = (
        labels,
        {teacher: f"{name[:room]}…" for teacher, name in labels.items()},
        {teacher: f"{name[: room // 2]}…{name[-(room - room // 2) :]}" for teacher, name in labels.items()},
    )
    short: dict[str, str] = {}
    for teacher, name in labels.items():
        fitting = (way for way in ways if len(way[teacher]) <= length or way is not labels)
        distinct = (way for way in fitting if list(way.values()).count(way[teacher]) == 1)
        text = next((way[teacher] for way in distinct), ways[0 if len(name) <= length else 1][teacher])
        taken = set(short.values())
        numbered = (f"{text} ({number})" for number in itertools.count(2))
        short[teacher] = next(option for option in itertools.chain([text], numbered) if option not in taken)
    return {teacher: short[teacher] + mark_of(teacher) for teacher in sorted(short, key=teacher_order)}


def distinct_labels(teachers: Iterable[str]) -> dict[str, str]:
    """Return the label of each teacher, without settings shared by all teachers with the same base name.

    Examples:
        >>> distinct_labels(["perm:budget=2", "plr:budget=2", "plr:budget=2:score=mna"])
        {'perm:budget=2': 'PERM', 'plr:budget=2': 'PLR', 'plr:budget=2:score=mna': 'PLR (score=mna)'}
    """
    split = {teacher: split_name(teacher) for teacher in dict.fromkeys(teachers)}
    shared: dict[str, set[tuple[str, str]]] = {}
    for name, settings in split.values():
        shared[name] = shared.get(name, set(settings.items())) & set(settings.items())
    return {
        teacher: label(join_name(name, dict(item for item in settings.items() if item not in shared[name])))
        for teacher, (name, settings) in split.items()
    }


def teacher_order(teacher: str) -> tuple[bool, bool, str]:
    """Return a sort key for teachers: those of `own_first`, then Random, then all other teachers by name."""
    return (teacher not in _OWN.get(), plain_name(teacher) != "random", label(teacher).lower())


@cache
def plain_name(teacher: str) -> str:
    """Return the letters and digits of a name in lower case: ``alpgmm`` for ALP-GMM and alp_gmm."""
    return "".join(character for character in teacher.lower() if character.isalnum())


def title(column: str, value: object) -> str:
    """Return a heading for a value in a result table's column, such as ``Mostly unfeasible``."""
    if column == "expert_knowledge":
        return f"{'no' if value == KnowledgeLevel.NONE else value} expert knowledge".capitalize()
    if column == "challenge":
        titles = {challenge.title for challenge in CHALLENGES if challenge.name == value}
        if len(titles) == 1:  # ambiguous for "original", a challenge of several environments
            return titles.pop()
    names = value if isinstance(value, tuple) else (value,)
    if column == "environment":
        return ", ".join(label(name) for name in names)
    return visible(", ".join(str(name) for name in names)).replace("_", " ").capitalize()


def order(column: str, value: object) -> tuple[int, str]:
    """Return a sort key for values: challenges as in the benchmark, levels by rank, others by name."""
    values: list[object] = []
    if column == "expert_knowledge":
        values = [level.value for level in KnowledgeLevel]
    elif column == "challenge":
        values = [challenge.name for challenge in CHALLENGES]
    return (values.index(value) if value in values else len(values), str(value))

"""Challenges of the benchmark: task spaces and test sets."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Final

from tma_ray.support.component_names import base_name, join_name, nearest, split_name
from tma_ray.support.quantities import COUNT, expanded
from tma_ray.support.validation import check_known, check_type
from tma_ray.tasks import TaskSpace, TestSet
from tma_ray.tasks.spaces import CUTS

BENCHMARK_VERSION: Final = 1
"""Version of the benchmark. A test checks that it is raised with the version of the physics, of the results'
schema, or of any built-in teacher, student or environment. Runs and releases record it; older runs have 0."""

TEST_SETS = Path(__file__).parent / "test_sets"

THINNING = "every"  # name of the setting that thins a test set

STUMP_TRACKS_UNITS = {"stump_height": "terrain steps of 0.4667 m", "obstacle_spacing": "m"}

STUMP_TRACKS_SPACE = TaskSpace.from_bounds(
    {"stump_height": (0, 3), "obstacle_spacing": (0, 6)}, STUMP_TRACKS_UNITS
)
"""Original task space of Stump Tracks (paper, appendix C)."""

PARKOUR_UNITS = {"creepers_width": "m", "creepers_height": "m", "creepers_spacing": "m"}


@dataclass(frozen=True)
class Challenge:
    """Variant of an environment that isolates one difficulty for teachers.

    Attributes:
        name: name of the challenge; with the seed of a run, it seeds the randomness shared by all teachers.
        test_set: name of a shipped test set.
        easy_task: task easy for an untrained student, the initial mean at high expert knowledge; None if
            unknown.
        other_test_sets: names of other test sets by body type.
        resets: shares of the budget after which the student is reset, ascending.
        cuts: intervals per dimension that are shuffled by the seed, 0 for none. Test set and easy task are
            not shuffled.
    """

    environment: str
    name: str
    title: str
    task_space: TaskSpace
    test_set: str
    easy_task: tuple[float, ...] | None
    other_test_sets: Mapping[str, str] = field(default_factory=dict)
    resets: tuple[float, ...] = ()
    cuts: int = 0

    def test_set_of(self, body_type: str) -> str:
        """Return the name of the test set for bodies of `body_type`, such as "swimmer"."""
        return self.other_test_sets.get(body_type, self.test_set)


def _stump_tracks(
    name: str,
    title: str,
    heights: tuple[float, float] = (0, 3),
    resets: tuple[float, ...] = (),
    cuts: int = 0,
) -> Challenge:
    """Return a challenge of Stump Tracks with the given bounds of the stump height, resets and cuts."""
    return Challenge(
        environment="stump_tracks",
        name=name,
        title=title,
        task_space=STUMP_TRACKS_SPACE.with_bounds("stump_height", *heights),
        test_set="stump_tracks",
        easy_task=(0, 6),
        resets=resets,
        cuts=cuts,
    )


def _parkour(
    name: str,
    title: str,
    *theta: tuple[float, float],
    water: tuple[float, float] = (0.0, 1.0),
    height: tuple[float, float] = (0.0, 4.0),
    spacing: tuple[float, float] = (0.0, 5.0),
    delta: float = 10.0,
    tests: str = "",
) -> Challenge:
    """Return a Parkour challenge; `theta` has three pairs of bounds, `tests` a test set for all bodies."""
    bounds = {
        **dict(zip(("theta_1", "theta_2", "theta_3"), theta, strict=True)),
        "water_level": water,
        "creepers_width": (0.25, 0.25),
        "creepers_height": height,
        "creepers_spacing": spacing,
        "terrain_cppn_scale": (delta, delta),
    }
    others = {} if tests else {"swimmer": "parkour_swimming", "climber": "parkour_climbing"}
    space = TaskSpace.from_bounds(bounds, PARKOUR_UNITS)
    return Challenge("parkour", name, title, space, tests or "parkour_walking", None, others)


def _easy_parkour(
    locomotion: str, theta: tuple[tuple[float, float], ...], water: float, delta: float
) -> Challenge:
    """Return an easy challenge of Parkour for one kind of locomotion, with its own test set."""
    easy = {"water": (water, water), "height": (0.0, 1.0), "spacing": (2.0, 5.0)}
    name, tests = f"easy_{locomotion}", f"parkour_easy_{locomotion}"
    return _parkour(name, f"Parkour, easy {locomotion}", *theta, **easy, delta=delta, tests=tests)


FLAT_GROUND = (0.87, 0.93), (0.66, 0.72), (0.47, 0.53)
"""Bounds of theta for gentle ground, whose height (delta 40) changes by at most 0.8 m within 2.33 m."""

FLAT_CEILING = (-0.15, -0.05), (0.9, 1.0), (0.1, 0.15)  # bounds of theta for a nearly flat ceiling
EASY_THETA = (-0.25, -0.05), (0.8, 1.0), (0.0, 0.2)  # bounds of theta in Parkour's easy space (appendix C)

CHALLENGES: tuple[Challenge, ...] = (
    _stump_tracks("original", "Original task space"),
    _stump_tracks("mostly_unfeasible", "Mostly unfeasible", heights=(0, 9)),
    _stump_tracks("mostly_trivial", "Mostly trivial", heights=(-3, 3)),
    _stump_tracks("forgetting_student", "Forgetting student", resets=(0.35, 0.7)),
    _stump_tracks("rugged_difficulty", "Rugged difficulty", cuts=CUTS),
    _stump_tracks("diverse_students", "Diverse students"),
    Challenge(
        environment="stump_tracks",
        name="easy",
        title="Easy task space",
        task_space=TaskSpace.from_bounds(
            {"stump_height": (0, 0.3), "obstacle_spacing": (3, 6)}, STUMP_TRACKS_UNITS
        ),
        test_set="stump_tracks_easy",
        easy_task=(0, 6),
    ),
    _parkour("original", "Parkour", (-0.35, 0.05), (0.6, 1.0), (-0.1, 0.3)),
    _parkour("easy", "Parkour, easy task space", *EASY_THETA),
    _parkour("easy_dry", "Parkour, easy task space without water", *EASY_THETA, water=(0.0, 0.2)),
    _parkour("hard", "Parkour, hard task space", (-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0)),
    _easy_parkour("walking", FLAT_GROUND, water=0.0, delta=40.0),
    _easy_parkour("swimming", FLAT_CEILING, water=1.0, delta=10.0),
    _easy_parkour("climbing", FLAT_CEILING, water=0.0, delta=25.0),
)
"""Stump Tracks has the original space of the paper's appendix C, whose easy task is [0, 6], and five
challenges: almost 80 % of the tasks are unfeasible, half are flat ground, the student is reset after 7 and 14
of 20 million steps, every dimension is cut in four and shuffled, or there are several bodies and students
(see `matrices`). All share the original's test set. The easy corner, in which every working student learns to
walk, is for trying out students, bodies and settings.

Parkour has the three spaces of appendix C (the original is the medium one), the easy one almost without
water, in which the paper's chimpanzee learns to climb, and an easy challenge for each kind of locomotion:
gentle dry ground, deep water, a nearly flat ceiling."""


def challenges_of(environment: str) -> dict[str, Challenge]:
    """Return the challenges of `environment` by name, ignoring its options; empty if it is unknown."""
    name = base_name(environment)
    return {challenge.name: challenge for challenge in CHALLENGES if challenge.environment == name}


def find_challenge(environment: str, name: str) -> Challenge:
    """Return the challenge called `name`, or raise a ValueError with the nearest match."""
    challenges = challenges_of(environment)
    if name not in challenges:
        hint = nearest(name, challenges)
        listed = ", ".join(challenges) or "none"
        raise ValueError(f"{environment} has no challenge {name!r}: {hint}known: {listed}")
    return challenges[name]


def shipped_test_sets() -> list[str]:
    """Return the names of the shipped test sets."""
    return sorted(path.stem for path in TEST_SETS.glob("*.csv"))


@cache
def _shipped(name: str, every: int) -> TestSet:
    """Return every nth task of a shipped test set (cached)."""
    if every == 1:
        return TestSet.from_csv(TEST_SETS / f"{name}.csv")
    whole = _shipped(name, 1)
    return TestSet(thinned(name, every), whole.dimensions, whole.tasks[::every])


def thinned(name: str, every: int) -> str:
    """Return the name of the test set that contains every nth task of `name`, starting with the first."""
    return name if every == 1 else join_name(name, {THINNING: every})


def load_test_set(name_or_path: str | Path) -> TestSet:
    """Return a test set: a shipped one by name, or any other from its CSV file.

    ``stump_tracks:every=2`` has every second task of ``stump_tracks``, from the first one on.

    Raises:
        ValueError: if the name or setting is unknown, or the file unreadable.
        TypeError: if it is neither a string nor a path.
    """
    check_type("test set", name_or_path, (str, Path), "a name or the path of a CSV file")
    name = str(name_or_path)
    base, settings = split_name(name)
    if base in shipped_test_sets():
        for key in settings:
            check_known(f"setting of test set {base}", key, [THINNING], "known:")
        every = COUNT(settings.get(THINNING, "1"))
        if every > len(_shipped(base, 1)):
            raise ValueError(f"{name}: expected at most {len(_shipped(base, 1))}, the number of its tasks")
        return _shipped(base, every)
    path = expanded(name)
    if not path.is_file():
        raise ValueError(
            f"no test set {name!r}: {nearest(name, shipped_test_sets())}"
            f"known: {', '.join(shipped_test_sets())}, "
            f"or give a path to a CSV file"
        )
    return TestSet.from_csv(path)

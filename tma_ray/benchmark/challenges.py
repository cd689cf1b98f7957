"""The named settings of the benchmark: which tasks a teacher may choose, and what is tested."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from tma_ray.support.component_names import base_name, join_name, nearest, split_name
from tma_ray.support.quantities import COUNT, expanded
from tma_ray.support.validation import check_known, check_type
from tma_ray.tasks import TaskSpace, TestSet
from tma_ray.tasks.spaces import CUTS

TEST_SETS = Path(__file__).parent / "test_sets"

EVERY = "every"  # setting in the name of a thinned test set

STUMP_TRACKS_UNITS = {"stump_height": "terrain steps of 0.4667 m", "obstacle_spacing": "m"}

STUMP_TRACKS_SPACE = TaskSpace.from_bounds(
    {"stump_height": (0, 3), "obstacle_spacing": (0, 6)}, STUMP_TRACKS_UNITS
)
"""The original space of Stump Tracks (paper, appendix C)."""

PARKOUR_UNITS = {"creepers_width": "m", "creepers_height": "m", "creepers_spacing": "m"}


@dataclass(frozen=True)
class Challenge:
    """One variant of an environment that isolates a difficulty for teachers.

    Attributes:
        environment: name in the environment registry.
        name: name of the challenge; with the seed it places what is random for all teachers alike.
        title: name in tables and figures.
        task_space: tasks that the teacher may choose from.
        test_set: name of a CSV shipped with the package, without its ending.
        easy_task: a task easy for an untrained student, the initial mean at high expert
            knowledge; None where none is known.
        other_test_sets: name of the CSV of each type of body that cannot live in the worlds of `test_set`.
        resets: shares of the budget after which the student forgets everything, in rising order.
        cuts: intervals per dimension that change places in the teacher's space, as the run's seed has it;
            0 if that is the world's own. Test set and easy task are of the world.
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
        """Return the name of the test set for bodies of `body_type`, as in "swimmer"."""
        return self.other_test_sets.get(body_type, self.test_set)


def _stump_tracks(
    name: str,
    title: str,
    heights: tuple[float, float] = (0, 3),
    resets: tuple[float, ...] = (),
    cuts: int = 0,
) -> Challenge:
    """Return a Stump Tracks of appendix C, whose mean stump heights lie in `heights`."""
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
    """Return the Parkour of three intervals of `theta`, tested on `tests`, or on those of each locomotion."""
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
    """Return an easy piece of Parkour for the bodies of one kind of locomotion, with tests drawn from it."""
    easy = {"water": (water, water), "height": (0.0, 1.0), "spacing": (2.0, 5.0)}
    name, tests = f"easy_{locomotion}", f"parkour_easy_{locomotion}"
    return _parkour(name, f"Parkour, easy {locomotion}", *theta, **easy, delta=delta, tests=tests)


FLAT_GROUND = (0.87, 0.93), (0.66, 0.72), (0.47, 0.53)
"""Where in theta the ground is gentlest: with delta 40 it rises and drops by at most 0.8 m within 2.33 m."""

FLAT_CEILING = (-0.15, -0.05), (0.9, 1.0), (0.1, 0.15)  # where in theta the ceiling is nearly flat
EASY_THETA = (-0.25, -0.05), (0.8, 1.0), (0.0, 0.2)  # of the easy space of Parkour (paper, appendix C)

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
"""Of Stump Tracks, the original space of the paper's appendix C, whose easy task is [0, 6], and its five
challenges: almost 80 % of the tasks are unfeasible, half are flat ground, the student forgets everything
after 7 and 14 of 20 million steps, every dimension is cut in four and shuffled, or there are several bodies
and students (`matrices` says which). All are tested on the original's grid. Then a corner of it in
which every working student learns to walk: for trying out students, bodies and settings. Of Parkour,
the three spaces of appendix C (its experiment takes the medium one, the original; each kind of locomotion has
test tasks), the easy one with so little water that there is none to see, in which the paper lets a chimpanzee
learn to climb, and an easy piece for each kind: gentle dry ground, deep water, a nearly flat ceiling."""


def challenges_of(environment: str) -> dict[str, Challenge]:
    """Return the challenges of `environment` by name; empty for one that the benchmark does not know.

    Options after its name, as in ``parkour:swinging_creepers=true``, make no difference.
    """
    known = base_name(environment)
    return {challenge.name: challenge for challenge in CHALLENGES if challenge.environment == known}


def find_challenge(environment: str, name: str) -> Challenge:
    """Return the challenge called `name`.

    Raises:
        ValueError: `environment` has no such challenge; the message holds the nearest match.
    """
    known = challenges_of(environment)
    if name not in known:
        hint = nearest(name, known)
        raise ValueError(
            f"{environment} has no challenge {name!r}: {hint}known: {', '.join(known) or 'none'}"
        )
    return known[name]


def shipped_test_sets() -> list[str]:
    """Return the names of the test sets shipped with the package."""
    return sorted(path.stem for path in TEST_SETS.glob("*.csv"))


@cache
def _shipped(name: str, every: int) -> TestSet:
    """Return every nth task of a shipped test set, read once: all runs of a plan ask for the same few."""
    if every == 1:
        return TestSet.from_csv(TEST_SETS / f"{name}.csv")
    whole = _shipped(name, 1)
    return TestSet(thinned(name, every), whole.dimensions, whole.tasks[::every])


def thinned(name: str, every: int) -> str:
    """Return the name of the test set that has the first task of `name`, and from there every nth."""
    return name if every == 1 else join_name(name, {EVERY: every})


def load_test_set(name_or_path: str | Path) -> TestSet:
    """Return a shipped test set by name, or any other from the path of a CSV file.

    A shipped one may be thinned: ``stump_tracks:every=2`` has its first task, its third, and so on.

    Raises:
        ValueError: neither a known name nor a readable file, or a setting that test sets do not have.
        TypeError: neither text nor a path.
    """
    check_type("test set", name_or_path, (str, Path), "a name or the path of a CSV file")
    name = str(name_or_path)
    base, settings = split_name(name)
    if base in shipped_test_sets():
        for key in settings:
            check_known(f"setting of test set {base}", key, [EVERY], "known:")
        every = COUNT(settings.get(EVERY, "1"))
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

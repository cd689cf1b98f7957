"""What the paper runs: each challenge's bodies, students, levels of expert knowledge and seeds."""

from __future__ import annotations

from dataclasses import dataclass

from tma_ray.benchmark.challenges import find_challenge
from tma_ray.tasks import KnowledgeLevel


@dataclass(frozen=True)
class Matrix:
    """Every combination of body, student and level on one challenge, each with all seeds.

    A teacher runs the combinations for which it is told enough. Its result at a level pools all bodies,
    students and seeds, also those of other matrices on the same challenge.

    Attributes:
        name: what files call it.
        environment: name in the environment registry.
        challenge: name of a challenge of that environment.
        embodiments: names of the bodies.
        students: names in the student registry.
        levels: expert knowledge offered.
        seeds: of each combination.

    Raises:
        ValueError: the environment has no such challenge.
    """

    name: str
    environment: str
    challenge: str
    embodiments: tuple[str, ...] = ("classic_bipedal",)
    students: tuple[str, ...] = ("sac",)
    levels: tuple[KnowledgeLevel, ...] = tuple(KnowledgeLevel)
    seeds: tuple[int, ...] = tuple(range(32))

    def __post_init__(self) -> None:
        find_challenge(self.environment, self.challenge)


def _parkour(milieu: str, embodiment: str, first_seed: int) -> Matrix:
    """Returns a third of the Parkour experiment: one body, with 16 seeds of its own."""
    return Matrix(
        name=f"parkour_{milieu}",
        environment="parkour",
        challenge="original",
        embodiments=(embodiment,),
        levels=(KnowledgeLevel.LOW,),
        seeds=tuple(range(first_seed, first_seed + 16)),
    )


ORIGINAL_SPACE = Matrix("original", "stump_tracks", "original")
"""The baseline on the original space of Stump Tracks."""

STUMP_TRACKS_CHALLENGES: tuple[Matrix, ...] = (
    Matrix("mostly_unfeasible", "stump_tracks", "mostly_unfeasible"),
    Matrix("mostly_trivial", "stump_tracks", "mostly_trivial"),
    Matrix("forgetting_student", "stump_tracks", "forgetting_student"),
    Matrix("rugged_difficulty", "stump_tracks", "rugged_difficulty"),
    Matrix(
        "diverse_students",
        "stump_tracks",
        "diverse_students",
        embodiments=("short_bipedal", "spider"),
        students=("sac", "ppo"),
    ),
)
"""The five challenges of the paper's appendix C; at each level the last has four combinations of body and
student, so a teacher that runs everywhere has 3 x (4 + 4) combinations of 32 seeds: 768 runs."""

PARKOUR: tuple[Matrix, ...] = (
    _parkour("walking", "classic_bipedal", 0),
    _parkour("swimming", "fish", 16),
    _parkour("climbing", "climbing_chimpanzee", 32),
)
"""The Parkour experiment of appendix C in the medium space: 48 seeds, 16 a body. No two bodies share a seed,
so that 48 random initial Gaussians are pooled and not 16 three times."""

MATRICES: tuple[Matrix, ...] = (ORIGINAL_SPACE, *STUMP_TRACKS_CHALLENGES, *PARKOUR)
"""All that the paper runs, for every teacher."""

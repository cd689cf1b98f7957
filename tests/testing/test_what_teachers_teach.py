"""What follows from the algorithms, seen in simulated students over seeds, each with a test that could fail.

Students were fixed by looking at Random alone, so none of this was tuned.
"""

from functools import cache

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from tma_ray.tasks import KnowledgeLevel
from tma_ray.testing import Simulation, find_simulated_challenge, simulate

NONE, LOW, HIGH = KnowledgeLevel
SEEDS = range(8)
P = 0.01


@cache
def mastered(
    challenge: str,
    teacher: str,
    level: KnowledgeLevel,
    episodes: int,
    seeds: range = SEEDS,
    **hyperparameters: int,
) -> tuple[float, ...]:
    """Mastered share of each seed, averaged over the run."""
    world = find_simulated_challenge(challenge)
    runs = [simulate(world, teacher, level, seed, episodes, hyperparameters) for seed in seeds]
    return tuple(float(np.mean(run.curve)) for run in runs)


def assert_greater(more: tuple[float, ...], less: tuple[float, ...]) -> None:
    """Mann and Whitney's one-sided test: no assumption about the distributions over seeds."""
    assert mannwhitneyu(more, less, alternative="greater").pvalue < P, (more, less)


def test_adr_never_leaves_a_start_that_is_too_hard() -> None:
    """It widens its box only by mastering the box's edges."""
    stuck = 0
    for seed in SEEDS:
        simulation = Simulation(find_simulated_challenge("mostly_unfeasible"), "adr", LOW, seed)
        start = simulation.teacher.knowledge.initial.mean
        if simulation.student.initial_observations(start).max() < 0.2:
            continue  # it was lucky
        for _ in range(1000):
            simulation.advance()
        np.testing.assert_allclose(simulation.teacher.probe(50), np.tile(start, (50, 1)), rtol=1e-6)
        stuck += 1
    assert stuck >= 6


@pytest.mark.slow
def test_adr_grows_from_a_start_that_is_easy() -> None:
    """At high expert knowledge its first task is the easiest, whatever else the space holds."""
    adr = mastered("mostly_unfeasible", "adr", HIGH, 2000)
    assert_greater(adr, mastered("mostly_unfeasible", "random", NONE, 2000))
    assert min(adr) > 0


@pytest.mark.slow
def test_adr_is_stopped_by_cliffs() -> None:
    """A box cannot jump over intervals that are too hard to those behind that are not."""
    assert_greater(*(mastered(each, "adr", HIGH, 10_000) for each in ("original", "rugged_difficulty")))


@pytest.mark.slow
def test_where_most_is_unfeasible_progress_finds_what_is_not() -> None:
    """ALP is 0 up to noise where nothing can be learned, so that ALP-GMM looks elsewhere; Random does not.

    Mixtures of at most 5 components, which fit faster; the next test has the usual 10. A quarter of the
    seeds find nothing in so few episodes, so there are more of them.
    """
    random = mastered("mostly_unfeasible", "random", NONE, 2000, range(16))
    progress = mastered("mostly_unfeasible", "alp_gmm", NONE, 2000, range(16), most_components=5)
    assert_greater(progress, random)


@pytest.mark.slow
@pytest.mark.parametrize("teacher", ["alp_gmm", "covar_gmm"])
def test_progress_beats_random_over_a_whole_training(teacher: str) -> None:
    random = mastered("mostly_unfeasible", "random", NONE, 10_000)
    assert_greater(mastered("mostly_unfeasible", teacher, NONE, 10_000), random)


@pytest.mark.slow
def test_an_expert_speeds_up_the_start_where_most_is_unfeasible() -> None:
    """ALP-GMM's first 150 tasks come from the easy corner instead of a space that is mostly hopeless."""
    informed, uninformed = (mastered("mostly_unfeasible", "alp_gmm", level, 2000) for level in (HIGH, NONE))
    assert_greater(informed, uninformed)

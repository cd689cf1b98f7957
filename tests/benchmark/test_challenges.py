from __future__ import annotations

import numpy as np
import pytest

from tma_ray.benchmark import CHALLENGES, Challenge, find_challenge, load_test_set, shipped_test_sets
from tma_ray.envs import make_environment
from tma_ray.tasks import TestSet


@pytest.mark.parametrize("challenge", CHALLENGES, ids=lambda challenge: challenge.name)
def test_every_challenge_can_be_built_and_evaluated(challenge: Challenge) -> None:
    domain = make_environment(challenge.environment).get_wrapper_attr("valid_domain")
    load_test_set(challenge.test_set).check(domain)
    assert domain.contains(np.stack([challenge.task_space.low, challenge.task_space.high]))
    assert challenge.easy_task is None or challenge.task_space.contains(challenge.easy_task)


def test_the_original_test_set_is_the_papers_grid() -> None:
    original = find_challenge("stump_tracks", "original")
    shipped = load_test_set(original.test_set)
    np.testing.assert_array_equal(shipped.tasks, TestSet.grid("grid", original.task_space, 10).tasks)
    assert len(shipped) == 100


def test_the_easy_test_set_is_drawn_from_its_space() -> None:
    easy = find_challenge("stump_tracks", "easy")
    drawn = easy.task_space.sample(np.random.default_rng(0), 20)
    np.testing.assert_array_equal(load_test_set(easy.test_set).tasks, drawn)


def test_no_shipped_test_set_is_orphaned() -> None:
    assert {challenge.test_set for challenge in CHALLENGES} == set(shipped_test_sets())

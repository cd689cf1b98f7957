import itertools

import numpy as np
import pytest
from parkour_demands import WALKER_DROP, WALKER_RISE, demands, difficulty

from tma_ray.benchmark import (
    CHALLENGES,
    MATRICES,
    STUMP_TRACKS_CHALLENGES,
    Challenge,
    Matrix,
    challenges_of,
    find_challenge,
    load_test_set,
    shipped_test_sets,
)
from tma_ray.envs import make_environment
from tma_ray.tasks import TestSet
from tma_ray.terrain.parkour import CPPN, parkour


@pytest.mark.parametrize("challenge", CHALLENGES, ids=lambda challenge: challenge.name)
def test_every_challenge_can_be_built_and_evaluated(challenge: Challenge) -> None:
    domain = make_environment(challenge.environment).get_wrapper_attr("valid_domain")
    for name in (challenge.test_set, *challenge.other_test_sets.values()):
        load_test_set(name).check(domain)
    assert domain.contains(np.stack([challenge.task_space.low, challenge.task_space.high]))
    assert challenge.easy_task is None or challenge.task_space.contains(challenge.easy_task)


@pytest.mark.parametrize("challenge", challenges_of("stump_tracks").values(), ids=lambda each: each.name)
def test_stump_tracks_are_built_at_every_corner(challenge: Challenge) -> None:
    environment = make_environment("stump_tracks")
    for corner in itertools.product(*zip(challenge.task_space.low, challenge.task_space.high, strict=True)):
        observation, _ = environment.reset(seed=0, options={"task": np.array(corner)})
        following, reward, terminated, _, _ = environment.step(np.zeros(4, np.float32))
        assert np.isfinite(observation).all()
        assert np.isfinite(following).all()
        assert np.isfinite(reward)
        assert not terminated


def test_stump_tracks_has_the_papers_five_challenges() -> None:
    known = challenges_of("stump_tracks")
    original, unfeasible, trivial, forgetting, rugged, diverse, _ = known.values()
    names = [each.name for each in (unfeasible, trivial, forgetting, rugged, diverse)]
    assert names == [matrix.challenge for matrix in STUMP_TRACKS_CHALLENGES]
    np.testing.assert_array_equal([unfeasible.task_space.low, unfeasible.task_space.high], [[0, 0], [9, 6]])
    np.testing.assert_array_equal([trivial.task_space.low, trivial.task_space.high], [[-3, 0], [3, 6]])
    assert forgetting.resets == (0.35, 0.7)
    assert rugged.cuts == 4
    for each in (forgetting, rugged, diverse):
        assert each.task_space == original.task_space
    for each in known.values():
        if each.name != "easy":
            assert (each.test_set, each.easy_task) == ("stump_tracks", (0, 6))
        assert not (each.resets and each.cuts)


def test_matrices_name_challenges_that_exist() -> None:
    assert len({matrix.name for matrix in MATRICES}) == len(MATRICES)
    with pytest.raises(ValueError, match="did you mean 'rugged_difficulty'"):
        Matrix("mine", "stump_tracks", "ruged_difficulty")


def test_the_original_test_set_is_the_papers_grid() -> None:
    original = find_challenge("stump_tracks", "original")
    shipped = load_test_set(original.test_set)
    np.testing.assert_array_equal(shipped.tasks, TestSet.grid("grid", original.task_space, 10).tasks)
    assert len(shipped) == 100


def test_a_thinned_test_set_has_every_second_task() -> None:
    whole, half = load_test_set("stump_tracks"), load_test_set("stump_tracks:every=2")
    np.testing.assert_array_equal(half.tasks, whole.tasks[::2])
    assert (half.name, half.dimensions) == ("stump_tracks:every=2", whole.dimensions)
    assert half.digest != whole.digest
    assert load_test_set("stump_tracks:every=1").digest == whole.digest
    assert len(load_test_set("stump_tracks:every=100")) == 1


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("evry=2", "no setting of test set stump_tracks 'evry': did you mean 'every'"),
        ("every=0", "expected a whole number"),
        ("every=2.5", "expected a whole number"),
        ("every=101", "expected at most 100"),
    ],
)
def test_other_ways_to_thin_a_test_set_are_refused(setting: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_test_set(f"stump_tracks:{setting}")


@pytest.mark.parametrize(
    "easy", [each for each in CHALLENGES if "easy" in each.test_set], ids=lambda challenge: challenge.test_set
)
def test_easy_test_sets_are_drawn_from_their_spaces(easy: Challenge) -> None:
    drawn = easy.task_space.sample(np.random.default_rng(0), 20)
    np.testing.assert_array_equal(load_test_set(easy.test_set).tasks, drawn)


def test_no_shipped_test_set_is_orphaned() -> None:
    named = {challenge.test_set for challenge in CHALLENGES}
    named |= {name for challenge in CHALLENGES for name in challenge.other_test_sets.values()}
    assert named == set(shipped_test_sets())


def test_bodies_are_tested_where_they_live() -> None:
    parkour, stumps = find_challenge("parkour", "original"), find_challenge("stump_tracks", "original")
    assert parkour.test_set_of("walker") == "parkour_walking"
    assert parkour.test_set_of("swimmer") == "parkour_swimming"
    assert parkour.test_set_of("climber") == "parkour_climbing"
    assert {stumps.test_set_of(body_type) for body_type in ("", "walker", "swimmer")} == {"stump_tracks"}


def test_parkours_spaces_lie_in_each_other_and_hold_two_dimensions_fixed() -> None:
    easy, medium, hard = (find_challenge("parkour", name).task_space for name in ("easy", "original", "hard"))
    assert hard.contains(np.stack([medium.low, medium.high]))
    assert medium.contains(np.stack([easy.low, easy.high]))
    for space in (easy, medium, hard):
        assert space.size == 8
        constant = [d.name for d in space.dimensions if d.low == d.high]
        assert constant == ["creepers_width", "terrain_cppn_scale"]


@pytest.mark.parametrize("name", ["parkour_walking", "parkour_swimming", "parkour_climbing"])
def test_sixty_parkour_tasks_are_from_the_medium_space_and_forty_are_not(name: str) -> None:
    medium, tests = find_challenge("parkour", "original").task_space, load_test_set(name)
    inside = [medium.contains(task) for task in tests.tasks]
    assert (len(inside), sum(inside)) == (100, 60)
    theta_outside = [not np.all((t[:3] >= medium.low[:3]) & (t[:3] <= medium.high[:3])) for t in tests.tasks]
    other_delta = tests.tasks[:, 7] != 10
    assert sum(theta_outside) >= 20
    assert sum(other_delta) >= 20


@pytest.mark.parametrize(
    ("name", "body_type"),
    [("parkour_walking", "walker"), ("parkour_swimming", "swimmer"), ("parkour_climbing", "climber")],
)
def test_parkours_test_tasks_are_feasible_and_ordered_in_each_source(name: str, body_type: str) -> None:
    cppn, rng = CPPN.load(), np.random.default_rng(0)
    worlds = (parkour(task, rng, cppn=cppn) for task in load_test_set(name).tasks)
    values = np.array([difficulty(demands(terrain, body_type)) for terrain in worlds])
    assert np.all(np.isfinite(values))
    for source in np.split(values, [60, 80]):
        assert np.all(np.diff(source) >= 0)
    cuts = (values[[19, 39]] + values[[20, 40]]) / 2  # where the medium space's tasks are cut into thirds
    assert np.bincount(np.searchsorted(cuts, values[60:])) == pytest.approx([13, 14, 13], abs=2)


def test_easy_pieces_of_parkour_are_gentle() -> None:
    cppn, rng = CPPN.load(), np.random.default_rng(0)
    for locomotion, body_type in (("walking", "walker"), ("swimming", "swimmer"), ("climbing", "climber")):
        space = find_challenge("parkour", f"easy_{locomotion}").task_space
        for task in space.sample(rng, 50):
            demanded = demands(parkour(task, rng, cppn=cppn), body_type)
            assert max(demanded.values()) <= 1, (locomotion, task.tolist())
            if body_type == "walker":
                assert demanded["rise"] * WALKER_RISE < 0.8
                assert demanded["drop"] * WALKER_DROP < 0.8

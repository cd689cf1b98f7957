import math
from array import array

import numpy as np
import pytest
from scipy import stats
from simulated_play import SPACES, ended, started

from tma_ray.tasks import KnowledgeLevel, Task, TaskSpace
from tma_ray.teachers.lp_acrl import split_evenly
from tma_ray.teachers.riac import RIAC, Cut, Region, Split, best_cut, cut_scores, random_cuts

STUMP_TRACKS = SPACES["stump_tracks"]


def riac(space: TaskSpace = STUMP_TRACKS) -> RIAC:
    return started("riac", space, level=KnowledgeLevel.NONE)


def progress(returns: list[float]) -> float:
    """|mean of the later half - mean of the earlier one|, the odd episode in the earlier."""
    if len(returns) <= 2:
        return 0.0
    later = len(returns) // 2
    return float(abs(np.mean(returns[-later:]) - np.mean(returns[:-later])))


def filled_region(space: TaskSpace, seed: int, count: int = 150) -> Region:
    rng = np.random.default_rng(seed)
    region = Region(np.array([space.low, space.high], dtype=np.float64), 150)
    for index, task in enumerate(space.sample(rng, count)):
        region.add(task, float(rng.normal(index * space.normalise(task)[0], 20)))
    return region


def inside(region: Region, task: Task) -> bool:
    return bool(np.all((task >= region.bounds[0]) & (task <= region.bounds[1])))


def played(space: TaskSpace, episodes: int) -> tuple[RIAC, list[tuple[Task, float]]]:
    """A teacher whose student learns at different speeds over the first dimension with width."""
    teacher, rng, history = riac(space), np.random.default_rng(1), []
    dimension = int(np.argmax(space.width > 0))
    for index in range(episodes):
        task = teacher.sample()
        speed = float(space.normalise(task)[dimension]) - 0.3
        history.append((task, speed * index + float(rng.normal(0, 10))))
        teacher.observe(ended(*history[-1]))
    return teacher, history


def test_progress_is_that_of_the_latest_150_returns() -> None:
    rng = np.random.default_rng(0)
    region, returns = Region(np.array([[0.0], [1.0]]), 150), []
    for index in range(500):
        assert region.progress == pytest.approx(progress(returns), abs=1e-9)
        if index == 300:
            region.forget(37)
            del returns[:37]
        returns = [*returns, float(rng.normal(-200, 50))][-150:]
        region.add(np.float32([0.5]), returns[-1])


def test_equal_returns_make_exactly_no_progress() -> None:
    region = Region(np.array([[0.0], [1.0]]), 150)
    for _ in range(333):
        region.add(np.float32([0.5]), -100.1)
        assert region.progress == 0.0


@pytest.mark.parametrize("name", SPACES)
@pytest.mark.parametrize("seed", range(3))
def test_the_cut_is_the_best_of_all_attempts(name: str, seed: int) -> None:
    space = SPACES[name]
    region = filled_region(space, seed)
    tasks = np.array(region.tasks)
    attempts = random_cuts(region.bounds, tasks, 75, 8, np.random.default_rng(seed))
    scored = {}
    for dimension, threshold in zip(*attempts, strict=True):
        left = [r for task, r in zip(tasks, region.returns, strict=True) if task[dimension] <= threshold]
        right = [r for task, r in zip(tasks, region.returns, strict=True) if task[dimension] > threshold]
        assert min(len(left), len(right)) >= 8
        sides = threshold - space.low[dimension], space.high[dimension] - threshold
        if min(sides) >= 0.1 * space.width[dimension]:
            score = len(left) * len(right) * abs(progress(left) - progress(right))
            scored[Cut(int(dimension), float(threshold))] = score
    cut = best_cut(region, 75, 8, 0.1 * space.width, np.random.default_rng(seed))
    assert cut is not None
    assert len(scored) > 10
    assert scored[cut] == pytest.approx(max(scored.values()))


def test_scores_weigh_the_difference_of_progress_by_the_populations() -> None:
    returns = np.array([0.0, 10.0, 0.0, 10.0, 4.0, 30.0, 2.0])
    left = np.array([[False, True, False, True, False, True, True], [True] * 6 + [False]])
    # left 10, 10 | 30, 2 makes 6 and right 0, 0 | 4 makes 4; left 0, 10, 0 | 10, 4, 30 makes 34 / 3
    np.testing.assert_allclose(cut_scores(left, returns), [4 * 3 * (6 - 4), 6 * 1 * 34 / 3])


def test_random_cuts_are_uniform_among_those_that_leave_enough_on_both_sides() -> None:
    rng = np.random.default_rng(5)
    space = TaskSpace.from_bounds({"a": (0, 3), "fixed": (2, 2), "b": (0, 6)})
    tasks = np.column_stack([rng.beta(2, 8, 150) * 3, np.full(150, 2.0), rng.beta(1, 1, 150) * 6])
    tasks = tasks.astype(np.float32)
    bounds = np.array([space.low, space.high], dtype=np.float64)
    dimensions, thresholds = random_cuts(bounds, tasks, 4_000, 8, rng)
    drawn = []
    while len(drawn) < 4_000:
        dimension = rng.choice(3)
        threshold = space.sample(rng)[dimension]
        left = np.sum(tasks[:, dimension] <= threshold)
        if 8 <= left <= 142:
            drawn.append((dimension, threshold))
    redrawn = np.array(drawn)
    assert set(dimensions) == {0, 2}
    assert np.mean(dimensions == 0) == pytest.approx(np.mean(redrawn[:, 0] == 0), abs=0.04)
    for dimension in (0, 2):
        same = stats.ks_2samp(thresholds[dimensions == dimension], redrawn[redrawn[:, 0] == dimension, 1])
        assert same.pvalue > 0.01


@pytest.mark.parametrize("name", SPACES)
def test_whole_regions_partition_the_space_and_keep_a_tenth_of_every_side(name: str) -> None:
    space = SPACES[name]
    teacher, _ = played(space, 2_000)
    whole = [region for region in teacher.regions_ if region.split is None]
    assert len(whole) > 4
    free = space.width > 0
    sides = np.array([np.diff(region.bounds, axis=0)[0] for region in whole])
    assert np.all(sides >= 0.1 * space.width - 1e-6)
    assert np.sum(np.prod(sides[:, free] / space.width[free], axis=1)) == pytest.approx(1)
    for task in space.sample(np.random.default_rng(0), 200):
        (holder,) = [region for region in whole if inside(region, task)]
        assert holder is teacher.regions_[teacher._path(task)[-1]]


@pytest.mark.parametrize("name", SPACES)
def test_every_region_holds_the_latest_episodes_in_its_box(name: str) -> None:
    space = SPACES[name]
    teacher, history = played(space, 1_500)
    for region, logged in zip(teacher.regions_, teacher.progress_, strict=True):
        returns = [value for task, value in history if inside(region, task)]
        assert 8 <= len(region) <= 150
        assert list(region.returns) == returns[-len(region) :]
        assert logged == pytest.approx(progress(returns[-len(region) :]), abs=1e-6)
        if region.split is not None:
            assert len(region) == min(150, len(returns))


def test_a_region_is_cut_when_it_holds_150_episodes() -> None:
    before, after = (played(STUMP_TRACKS, episodes)[0].regions_ for episodes in (149, 150))
    assert [len(region) for region in before] == [149]
    assert len(after) == 3
    assert sum(len(region) for region in after[1:]) == 150


@pytest.mark.parametrize("bounds", [(2, 2), (0, 1)])
def test_a_full_region_that_cannot_be_cut_forgets_its_oldest_quarter(bounds: tuple[float, float]) -> None:
    teacher = riac(TaskSpace.from_bounds({"x": bounds}))
    for index in range(150):  # without width, or with all tasks at one place
        teacher.observe(ended(np.float32([bounds[1]]), float(index)))
    assert len(teacher.regions_) == 1
    assert list(teacher.regions_[0].returns) == list(range(37, 150))
    assert teacher.progress_[0] == progress(list(range(37, 150)))


def three_regions(teacher: RIAC, *progress: float) -> None:
    """The space and its halves of low and high stumps; the second task of each half is its worst."""
    root = teacher.regions_[0]
    for height, episodic_return in ((0.2, 5.0), (0.5, 1.0), (2.2, 5.0), (2.5, 2.0)):
        root.add(np.float32([height, 3.0]), episodic_return)
    cut = Cut(0, 1.5)
    root.split = Split(cut, 1, 2)
    teacher.regions_.extend(root.parts(cut))
    teacher.progress_ = array("d", progress)


def within(count: int, trials: int, share: float) -> bool:
    return abs(count - trials * share) <= 4 * math.sqrt(trials * share * (1 - share)) + 1e-9


def test_a_tenth_is_mutated_a_fifth_uniform_and_the_rest_in_regions() -> None:
    teacher = riac()
    three_regions(teacher, 0.0, 0.0, 7.0)
    teacher.mutation_std = 1e-3
    tasks = np.stack([teacher.sample() for _ in range(6_000)])
    mutated = np.all(np.abs(tasks - [2.5, 3.0]) < 0.005, axis=1)
    low = tasks[:, 0] < 1.5  # only the uniform ones, half of the time
    assert within(mutated.sum(), 6_000, 0.1)
    assert within(low.sum(), 6_000, 0.2 / 2)
    assert within((~mutated & ~low).sum(), 6_000, 0.7 + 0.2 / 2)
    assert np.all(teacher.probe(500)[:, 0] >= 1.5)


def test_regions_are_drawn_in_proportion_to_progress_divided_ones_included() -> None:
    teacher = riac()
    teacher.explore = teacher.mutate = 0.0
    three_regions(teacher, 20.0, 10.0, 70.0)
    high = sum(teacher.sample()[0] > 1.5 for _ in range(5_000))
    assert within(high, 5_000, 0.7 + 0.2 / 2)
    teacher.progress_ = array("d", [0.0, 0.0, 0.0])
    high = sum(teacher.sample()[0] > 1.5 for _ in range(5_000))
    assert within(high, 5_000, 0.5)


def test_before_anything_was_played_a_mutation_is_a_uniform_task() -> None:
    tasks = []
    for seed in range(60):
        teacher = started("riac", STUMP_TRACKS, seed, KnowledgeLevel.NONE, mutate=0.9, explore=0.1)
        tasks.append(teacher.sample())
    np.testing.assert_allclose(STUMP_TRACKS.normalise(tasks).mean(axis=0), 0.5, atol=0.15)


def test_mutations_that_leave_their_region_end_on_its_faces() -> None:
    teacher = riac()
    three_regions(teacher, 0.0, 0.0, 7.0)
    teacher.mutate, teacher.explore, teacher.mutation_std = 1.0, 0.0, 100.0
    for _ in range(100):
        task = teacher.sample()
        assert inside(teacher.regions_[2], task)
        assert teacher._path(task) == [0, 2]


def test_it_follows_progress() -> None:
    teacher = riac()
    for index in range(2_000):  # only low stumps and wide gaps can be learned
        task = teacher.sample()
        learnable = task[0] < 1.0 and task[1] > 3.0
        teacher.observe(ended(task, -100 + (0.2 * index if learnable else 0.0)))
    probes = teacher.probe(500)
    share = np.mean((probes[:, 0] < 1.2) & (probes[:, 1] > 2.5))
    assert share > 0.5  # a sixth of the space


def test_it_logs_its_regions_and_no_more_than_one_box_an_episode() -> None:
    teacher, history = played(SPACES["twenty"], 2_000)
    updates = teacher.drain_updates()
    assert len(updates) == 2_000 // 150
    assert sum(len(update.boxes) for update in updates) < len(history)
    last = updates[-1]
    assert last.scalars["undivided_regions"] == (len(last.boxes) + 1) / 2
    for box, region in zip(last.boxes, teacher.regions_, strict=False):
        np.testing.assert_array_equal([box.low, box.high], region.bounds)


@pytest.mark.parametrize(
    ("dimensions", "cells", "counts"),
    [(1, 36, (36,)), (2, 36, (6, 6)), (3, 36, (4, 3, 3)), (3, 7, (2, 2, 1)), (20, 4, (2, 2, *[1] * 18))],
)
def test_the_grid_is_as_even_as_its_size_allows(dimensions: int, cells: int, counts: tuple[int, ...]) -> None:
    assert split_evenly(dimensions, cells) == counts


def test_chances_are_the_softmax_of_the_change_of_mean_returns() -> None:
    teacher = started("lp_acrl", SPACES["line"], cells=3, stage_episodes=4, temperature=20.0)
    for stage, changes in (
        (((-0.9, 10), (-0.8, 30), (0.0, 5), (0.9, 100)), [0, 0, 0]),  # no stage before the first
        (((-0.9, 50), (-0.8, 70), (0.1, 15), (0.9, 70)), [60 - 20, 15 - 5, 70 - 100]),
        (((-0.9, 50), (-0.9, 50), (-0.9, 50), (0.9, 90)), [50 - 60, 0, 90 - 70]),  # no news of the middle
    ):
        for x, gained in stage:
            teacher.observe(ended([x], gained))
        weights = np.exp(np.array(changes) / 20)
        np.testing.assert_allclose(teacher.chances_, weights / weights.sum())
    drawn = (np.digitize(teacher.probe(20_000)[:, 0], [-1 / 3, 1 / 3]) == np.arange(3)[:, None]).mean(axis=1)
    np.testing.assert_allclose(drawn, teacher.chances_, atol=0.01)

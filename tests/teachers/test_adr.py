import numpy as np
import pytest
from simulated_play import SPACES, ended, started

from tma_ray.tasks import KnowledgeLevel, TaskSpace
from tma_ray.teachers.adr import ADR, Boundary

STUMP_TRACKS = SPACES["stump_tracks"]
MIDDLE = (1.5, 3.0)
UPPER_HEIGHT = Boundary(side=1, dimension=0)
BOUNDARIES = [Boundary(side, dimension) for side in (0, 1) for dimension in (0, 1)]


def adr(easy_task: tuple[float, ...] = MIDDLE, space: TaskSpace = STUMP_TRACKS, **options: float) -> ADR:
    return started("adr", space, easy_task=easy_task, **options)


def play_boundary(teacher: ADR, boundary: Boundary, *returns: float) -> None:
    """Give `returns` for tasks set to `boundary`; tasks that were not count for nothing."""
    remaining = list(returns)
    while remaining:
        task = teacher.sample()
        if teacher.boundary_ == boundary:
            teacher.observe(ended(task, remaining.pop(0)))


def test_it_starts_from_a_single_task() -> None:
    teacher = adr()
    tasks = np.stack([teacher.sample() for _ in range(50)])
    np.testing.assert_array_equal(tasks, np.tile(np.float32(MIDDLE), (50, 1)))
    low = started("adr", STUMP_TRACKS, seed=5, level=KnowledgeLevel.LOW)
    np.testing.assert_array_equal(low.probe(3), np.tile(np.float32(low.knowledge.initial.mean), (3, 1)))


@pytest.mark.parametrize(
    ("returns", "moved"),
    [
        ([180.0] * 10, 0.1),
        ([0.0] * 10, -0.1),
        ([0.5] * 10, 0.0),
        ([179.9] * 10, 0.0),
        ([-100.0, 460.0] * 5, 0.1),
    ],
)
@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_ten_returns_move_their_boundary(boundary: Boundary, returns: list[float], moved: float) -> None:
    teacher = adr()
    start = np.array([[1.0, 2.0], [2.0, 4.0]])
    teacher.bounds_ = start.copy()
    play_boundary(teacher, boundary, *returns[:9])
    np.testing.assert_array_equal(teacher.bounds_, start)
    play_boundary(teacher, boundary, returns[9])
    expected = start.copy()
    expected[boundary] += moved if boundary.side == 1 else -moved
    np.testing.assert_allclose(teacher.bounds_, expected, atol=1e-12)
    play_boundary(teacher, boundary, *returns[:9])  # the queue was emptied
    np.testing.assert_allclose(teacher.bounds_, expected, atol=1e-12)


def test_only_tasks_set_to_a_boundary_are_queued() -> None:
    teacher = adr(queue_size=1_000)  # every task lies on all four boundaries of the single one
    queued = 0
    for _ in range(30):
        task = teacher.sample()
        queued += teacher.boundary_ is not None
        teacher.observe(ended(task, 90.0))
        assert sum(len(queue) for queue in teacher.queues_.values()) == queued
    assert 0 < queued < 30


def test_the_box_stays_inside_the_space_and_is_then_left_alone() -> None:
    teacher = adr()
    for _ in range(4_000):
        teacher.observe(ended(teacher.sample(), 300.0))
    np.testing.assert_allclose(teacher.bounds_, [STUMP_TRACKS.low, STUMP_TRACKS.high], atol=1e-12)
    for _ in range(200):  # nothing is left to test, and no boundary moves in again
        teacher.observe(ended(teacher.sample(), -100.0))
        assert teacher.boundary_ is None
    np.testing.assert_allclose(teacher.bounds_, [STUMP_TRACKS.low, STUMP_TRACKS.high], atol=1e-12)


def test_a_boundary_never_passes_the_opposite_one() -> None:
    teacher = adr()
    teacher.bounds_ = np.array([[1.46, 3.0], [1.5, 3.0]])
    play_boundary(teacher, UPPER_HEIGHT, *[-100.0] * 10)
    np.testing.assert_array_equal(teacher.bounds_, [[1.46, 3.0], [1.46, 3.0]])


def test_boundaries_are_set_with_their_share_and_equally_often() -> None:
    teacher = adr()
    teacher.bounds_ = np.array([[1.0, 2.0], [2.0, 4.0]])
    boundaries, tasks = [], []
    for _ in range(8_000):
        tasks.append(teacher.sample())
        boundaries.append(teacher.boundary_)
    for boundary in BOUNDARIES:
        on_it = [task for task, of in zip(tasks, boundaries, strict=True) if of == boundary]
        assert len(on_it) == pytest.approx(8_000 * 0.7 / 4, abs=4 * np.sqrt(8_000 * 0.175 * 0.825))
        assert {task[boundary.dimension] for task in on_it} == {np.float32(teacher.bounds_[boundary])}
    free = np.stack([task for task, boundary in zip(tasks, boundaries, strict=True) if boundary is None])
    np.testing.assert_allclose(free.mean(axis=0), MIDDLE, atol=0.06)
    np.testing.assert_allclose(free.std(axis=0), np.array([1, 2]) / np.sqrt(12), atol=0.03)
    probes = teacher.probe(1_000)
    assert np.all((probes > teacher.bounds_[0]) & (probes < teacher.bounds_[1]))


def test_dimensions_without_width_are_never_tested() -> None:
    space = SPACES["with_constants"]
    teacher = adr((0.5, 10.0, 0.0), space)
    tested = set()
    for _ in range(3_000):
        task = teacher.sample()
        assert task[1] == 10
        if teacher.boundary_ is not None:
            tested.add(teacher.boundary_.dimension)
        teacher.observe(ended(task, 200.0))
    assert tested == {0, 2}
    nowhere = adr((3.0,), TaskSpace.from_bounds({"fixed": (3, 3)}))
    for _ in range(20):
        nowhere.observe(ended(nowhere.sample(), 200.0))
        assert nowhere.sample() == 3


def test_the_start_and_every_move_are_logged_with_the_return_that_caused_it() -> None:
    teacher = adr()
    (update,) = teacher.drain_updates()
    np.testing.assert_array_equal([update.boxes[0].low, update.boxes[0].high], [MIDDLE, MIDDLE])
    assert update.scalars == {"share_of_stump_height": 0, "share_of_obstacle_spacing": 0}
    play_boundary(teacher, UPPER_HEIGHT, *[200.0] * 10)
    (update,) = teacher.drain_updates()
    np.testing.assert_allclose([update.boxes[0].low, update.boxes[0].high], [[1.5, 3.0], [1.6, 3.0]])
    assert update.boxes[0].score == 200.0
    assert update.scalars == pytest.approx({"share_of_stump_height": 0.1 / 3, "share_of_obstacle_spacing": 0})
    play_boundary(teacher, UPPER_HEIGHT, *[200.0] * 10)
    assert update.boxes[0].high[0] == pytest.approx(1.6)  # what was logged stays as it was


def naive_adr(moves: list[tuple[Boundary, float]], space: TaskSpace, start: list[float]) -> np.ndarray:
    """The algorithm as the paper tells it, one dimension at a time."""
    low, high = list(start), list(start)
    queues: dict[Boundary, list[float]] = {}
    for boundary, episodic_return in moves:
        queue = queues.setdefault(boundary, [])
        queue.append(episodic_return)
        if len(queue) < 10:
            continue
        mean, dim = sum(queue) / 10, boundary.dimension
        queue.clear()
        step = 0.1 if mean >= 180 else -0.1 if mean <= 0 else 0.0
        if boundary.side == 0:
            low[dim] = min(max(low[dim] - step, float(space.low[dim])), high[dim])
        else:
            high[dim] = max(min(high[dim] + step, float(space.high[dim])), low[dim])
    return np.array([low, high])


@pytest.mark.parametrize("name", SPACES)
def test_it_follows_a_naive_implementation_through_ups_and_downs(name: str) -> None:
    space = SPACES[name]
    start = [float(value) for value in space.denormalise([0.4] * space.size)]
    teacher = adr(tuple(start), space)
    rng, moves = np.random.default_rng(2), []
    for index in range(3_000):
        task = teacher.sample()
        assert space.contains(task)
        episodic_return = float(rng.normal(200 if index % 1500 < 1000 else -20, 60))
        if teacher.boundary_ is not None:
            moves.append((teacher.boundary_, episodic_return))
        teacher.observe(ended(task, episodic_return))
    np.testing.assert_allclose(teacher.bounds_, naive_adr(moves, space, start), atol=1e-12)
    assert np.all(teacher.bounds_[0] <= teacher.bounds_[1])
    assert len(teacher.drain_updates()) > 11

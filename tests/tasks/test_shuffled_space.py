import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tma_ray.tasks import ShuffledSpace, TaskSpace

WITH_CONSTANT = TaskSpace.from_bounds({"height": (-3, 9), "fixed": (10, 10), "spacing": (0, 6)})


@st.composite
def shuffled_spaces(draw: st.DrawFn) -> ShuffledSpace:
    bounds = {}
    for index in range(draw(st.integers(1, 6))):
        low = draw(st.floats(-1024, 1024, width=32))
        width = draw(st.one_of(st.just(0.0), st.floats(0.125, 1024, width=32)))
        bounds[f"x{index}"] = (low, low + width)
    generator = np.random.default_rng(draw(st.integers(0, 2**31)))
    return ShuffledSpace.shuffle(TaskSpace.from_bounds(bounds), generator, cuts=draw(st.integers(1, 7)))


def rounding(space: TaskSpace) -> np.ndarray:
    """What two float32 roundings may move a task by."""
    return 4 * np.spacing(np.maximum(np.abs(space.low), np.abs(space.high)))


@given(shuffled_spaces(), st.data())
def test_each_map_undoes_the_other(shuffled: ShuffledSpace, data: st.DataObject) -> None:
    space = shuffled.space
    shares = data.draw(arrays(np.float64, (3, space.size), elements=st.floats(0, 1)))
    tasks = space.denormalise(shares)
    for there, back in ((shuffled.to_world, shuffled.from_world), (shuffled.from_world, shuffled.to_world)):
        moved = there(tasks)
        assert moved.dtype == np.float32
        assert space.contains(moved)
        assert np.all(np.abs(back(moved) - tasks) <= rounding(space))


@given(shuffled_spaces(), st.data())
def test_no_map_leaves_its_interval_at_the_edges(shuffled: ShuffledSpace, data: st.DataObject) -> None:
    """An edge belongs to the interval below it, and so must its image, for the way back to be the same."""
    space, cuts = shuffled.space, shuffled.order.shape[1]
    edges = np.linspace(space.low, space.high, cuts + 1, dtype=np.float32)
    edge = data.draw(st.integers(0, cuts))
    steps = data.draw(st.integers(-2, 2))
    task = edges[edge]
    for _ in range(abs(steps)):
        task = np.nextafter(task, space.low if steps < 0 else space.high)
    expected = np.sum(task > edges[1:-1], axis=0)  # interval of each coordinate
    moved = shuffled.to_world(task)
    free = space.width > 0
    found = np.sum(moved > edges[1:-1], axis=0)
    np.testing.assert_array_equal(found[free], shuffled.order[np.arange(space.size), expected][free])


def test_it_is_the_interpolation_of_the_paper() -> None:
    """Against a loop over pairs of intervals, as appendix C writes it."""
    shuffled = ShuffledSpace.shuffle(WITH_CONSTANT, np.random.default_rng(5))
    tasks = WITH_CONSTANT.sample(np.random.default_rng(6), 200)
    worlds = shuffled.to_world(tasks)
    for task, world in zip(tasks, worlds, strict=True):
        for d, dimension in enumerate(WITH_CONSTANT.dimensions):
            size = (dimension.high - dimension.low) / 4
            originals = [(dimension.low + j * size, dimension.low + (j + 1) * size) for j in range(4)]
            pairs = [originals[j] for j in shuffled.order[d]]
            j = next(j for j, (low, high) in enumerate(originals) if low <= task[d] <= high)
            expected = np.interp(task[d], originals[j], pairs[j])
            assert world[d] == pytest.approx(expected, abs=1e-5)


def test_whole_cells_change_places_and_volume_stays() -> None:
    """Uniform tasks stay uniform; each dimension is shuffled on its own."""
    shuffled = ShuffledSpace.shuffle(WITH_CONSTANT, np.random.default_rng(1))
    worlds = shuffled.to_world(WITH_CONSTANT.sample(np.random.default_rng(2), 8000))
    for d in (0, 2):
        shares = np.histogram(WITH_CONSTANT.normalise(worlds)[:, d], bins=8, range=(0, 1))[0] / 8000
        np.testing.assert_allclose(shares, 1 / 8, atol=0.015)
    assert np.all(worlds[:, 1] == 10)
    orders = [ShuffledSpace.shuffle(WITH_CONSTANT, np.random.default_rng(seed)).order for seed in range(40)]
    assert any(np.any(order[0] != order[2]) for order in orders)
    assert len({order.tobytes() for order in orders}) > 35


def test_shapes_with_leading_axes_and_the_same_generator_give_the_same() -> None:
    first = ShuffledSpace.shuffle(WITH_CONSTANT, np.random.default_rng(0))
    second = ShuffledSpace.shuffle(WITH_CONSTANT, np.random.default_rng(0))
    tasks = WITH_CONSTANT.sample(np.random.default_rng(3), 24)
    together = first.to_world(tasks.reshape(2, 3, 4, 3))
    np.testing.assert_array_equal(together.reshape(24, 3), [second.to_world(task) for task in tasks])
    assert np.array_equal(first.order, second.order)


def test_what_cannot_be_shuffled_is_refused() -> None:
    with pytest.raises(ValueError, match="exceed the shuffled space"):
        ShuffledSpace.shuffle(WITH_CONSTANT, np.random.default_rng(0)).to_world([0, 10, 7])
    with pytest.raises(ValueError, match="cuts = 0"):
        ShuffledSpace.shuffle(WITH_CONSTANT, np.random.default_rng(0), cuts=0)
    with pytest.raises(ValueError, match="permutation"):
        ShuffledSpace(TaskSpace.from_bounds({"x": (0, 1)}), np.array([[0, 0, 1, 2]]))
    narrow = TaskSpace.from_bounds({"x": (1, float(np.nextafter(np.float32(1), np.float32(2))))})
    with pytest.raises(ValueError, match="'x' is too narrow"):
        ShuffledSpace.shuffle(narrow, np.random.default_rng(0))

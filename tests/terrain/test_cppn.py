"""The CPPN: closed forms on small cases, a plain recomputation in float64, errors of files."""

import csv
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from tma_ray.terrain.parkour import CPPN, POINTS, SHAPES, outlines, softplus
from tma_ray.terrain.terrain import STARTPAD_STEPS, TERRAIN_STEP

SEEDS = range(3)


def weights(seed: int = 0, scale: float = 1.0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: rng.normal(0, scale, shape).astype(np.float32) for name, shape in SHAPES.items()}


def zeros() -> dict[str, np.ndarray]:
    return {name: np.zeros(shape, dtype=np.float32) for name, shape in SHAPES.items()}


def save(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    np.savez(path, **arrays)
    return path


def test_softplus_is_the_logarithm_of_one_plus_the_exponential() -> None:
    values = np.linspace(-30, 30, 1001, dtype=np.float32)
    np.testing.assert_allclose(softplus(values), np.logaddexp(0, values.astype(np.float64)), atol=2e-6)


@pytest.mark.parametrize(("value", "expected"), [(-1e30, 0.0), (-1000, 0.0), (1000, 1000.0), (1e30, 1e30)])
def test_softplus_does_not_overflow(value: float, expected: float) -> None:
    with np.errstate(over="raise", invalid="raise"):
        assert softplus(np.array([value], dtype=np.float32))[0] == np.float32(expected)


def test_a_network_of_one_path_in_closed_form() -> None:
    small = zeros()
    small["w1"][0, 0], small["w1"][2, 0] = 2.0, 0.5  # x and the second theta
    small["w2"][0, 0] = 3.0
    small["w3"][0, 0] = -1.5
    small["w4"][0, 0] = 0.7
    small["w5"][0] = 4.0, -4.0
    x = np.linspace(0, 1, POINTS)
    first = np.logaddexp(0, 3 * np.tanh(2 * x + 0.5 * 0.8))
    last = np.logaddexp(0, 0.7 * np.tanh(-1.5 * (first + 0.0)))
    curves = CPPN(small).curves([9.0, 0.8, -9.0])
    np.testing.assert_allclose(curves[:, 0], 4 * last, atol=1e-5)
    np.testing.assert_array_equal(curves[:, 1], -curves[:, 0])


@pytest.mark.parametrize("seed", SEEDS)
def test_many_thetas_at_once_equal_each_alone_in_float64(seed: int) -> None:
    arrays = weights(seed)
    theta = np.random.default_rng(seed).uniform(-2, 2, (2, 5, 3))
    curves = CPPN(arrays).curves(theta)
    assert curves.shape == (2, 5, POINTS, 2)
    assert curves.dtype == np.float32
    for place in np.ndindex(2, 5):
        signal = np.column_stack([np.arange(POINTS) / 199, np.tile(theta[place], (POINTS, 1))])
        activations = 2 * (np.tanh, lambda value: np.logaddexp(0, value))
        for name, activation in zip(("w1", "w2", "w3", "w4"), activations, strict=True):
            signal = activation(signal @ arrays[name].astype(np.float64))
        expected = signal @ arrays["w5"].astype(np.float64)
        np.testing.assert_allclose(curves[place], expected, atol=5e-3)


def test_curves_do_not_depend_on_the_number_of_threads() -> None:
    theta = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    with threadpool_limits(1):
        alone = CPPN(weights()).curves(theta)
    with threadpool_limits(2):
        np.testing.assert_array_equal(CPPN(weights()).curves(theta), alone)


def test_the_shipped_weights_are_drawn_from_the_truncated_normal() -> None:
    for name, matrix in CPPN.load().weights.items():
        assert matrix.dtype == np.float32
        assert np.abs(matrix).max() <= 4.0
        if matrix.size == 64 * 64:
            assert matrix.std() == pytest.approx(2 * 0.8796, rel=0.03), name


def test_weights_are_read_back(tmp_path: Path) -> None:
    arrays = weights(1)
    loaded = CPPN.load(save(tmp_path / "own.npz", {**arrays, "note": np.array(3)}))
    np.testing.assert_array_equal(loaded.curves([1, 2, 3]), CPPN(arrays).curves([1, 2, 3]))


def test_files_that_hold_no_network_are_refused(tmp_path: Path) -> None:
    arrays = weights()
    with pytest.raises(ValueError, match=r"no file of CPPN weights '.*absent\.npz'"):
        CPPN.load(tmp_path / "absent.npz")
    text = tmp_path / "text.npz"
    text.write_text("w1")
    with pytest.raises(ValueError, match=r"text\.npz"):
        CPPN.load(text)
    one = tmp_path / "one.npy"
    np.save(one, np.zeros(3))
    with pytest.raises(ValueError, match=r"not an \.npz file"):
        CPPN.load(one)
    with pytest.raises(ValueError, match=r"less\.npz: weights 'w4' are missing"):
        CPPN.load(save(tmp_path / "less.npz", {k: v for k, v in arrays.items() if k != "w4"}))
    with pytest.raises(ValueError, match=r"weights 'w3' of shape \(64, 32\).*\(64, 64\)"):
        CPPN.load(save(tmp_path / "narrow.npz", {**arrays, "w3": arrays["w3"][:, :32]}))
    with pytest.raises(ValueError, match=r"weights 'w2'.*finite"):
        CPPN.load(save(tmp_path / "nan.npz", {**arrays, "w2": arrays["w2"] * np.nan}))


BOXES = {
    "easy": ((-0.25, -0.05), (0.8, 1.0), (0.0, 0.2)),
    "medium": ((-0.35, 0.05), (0.6, 1.0), (-0.1, 0.3)),
    "hard": ((-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0)),
}
"""The paper's spaces of theta (appendix C)."""

DELTA, TASKS = 10.0, 400


@pytest.fixture(scope="module")
def release() -> dict[tuple[str, str], float]:
    """Means of the release's terrains, by box and figure."""
    path = Path(__file__).parents[1] / "reference" / "terrain.csv"
    with path.open(newline="") as file:
        return {(row["box"], row["figure"]): float(row["mean"]) for row in csv.DictReader(file)}


@pytest.fixture(scope="module", params=BOXES)
def box(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def heights(box: str) -> tuple[np.ndarray, np.ndarray]:
    """Grounds and ceilings (n, 200) of uniform tasks of a box, in m above their starts."""
    theta = np.random.default_rng(1).uniform(*np.transpose(BOXES[box]), size=(TASKS, 3))
    curves = CPPN.load().curves(theta.astype(np.float32)).astype(np.float64)
    ground, ceiling = np.moveaxis((curves - curves[:, :1]) / DELTA, -1, 0)
    return ground, ceiling


@pytest.mark.parametrize("height", ["2.7", "5"])
def test_as_many_leave_room(height: str, box: str, heights: tuple[np.ndarray, np.ndarray], release) -> None:
    ground, ceiling = heights
    clearance = (ceiling - ground).min(axis=1) + 200 / DELTA
    expected = release[box, f"share_of_tasks_with_smallest_clearance_above_{height}"]
    error = np.sqrt(expected * (1 - expected) / TASKS)
    assert np.mean(clearance > float(height)) == pytest.approx(expected, abs=0.05 + 2 * error)


def test_grounds_are_as_steep_and_as_far(box: str, heights: tuple[np.ndarray, np.ndarray], release) -> None:
    ground, _ = heights
    slope = np.abs(np.diff(ground, axis=1)).mean() / TERRAIN_STEP
    assert slope == pytest.approx(release[box, "mean_slope"], rel=0.2)
    assert np.ptp(ground, axis=1).mean() == pytest.approx(release[box, "ground_range"], rel=0.2)


def test_tracks_start_at_the_same_heights(release) -> None:
    found = outlines(np.zeros(3, np.float32), DELTA, CPPN.load())
    for outline, figure in zip(found, ("ground_at_start", "ceiling_at_start"), strict=True):
        assert outline[STARTPAD_STEPS] == pytest.approx(release["all", figure], abs=1e-4)

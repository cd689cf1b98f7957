"""Normalising flows in closed form; what teachers do with torch leaves no trace in the process."""

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
import torch
from simulated_play import SPACES, play, started

from tma_ray.teachers.networks import DTYPE, FACE_DISTANCE, RealNVP, descend, slow_softplus

NETWORK_TEACHERS = ["goal_gan", "setter_solver"]


@pytest.fixture
def unusual_torch() -> Iterator[None]:
    threads, dtype, grad = torch.get_num_threads(), torch.get_default_dtype(), torch.is_grad_enabled()
    torch.set_num_threads(2)
    torch.set_default_dtype(torch.float64)
    torch.set_grad_enabled(False)
    torch.manual_seed(123)
    yield
    torch.set_num_threads(threads)
    torch.set_default_dtype(dtype)
    torch.set_grad_enabled(grad)


@pytest.mark.parametrize("name", NETWORK_TEACHERS)
def test_the_global_state_is_neither_used_nor_changed(name: str, request: pytest.FixtureRequest) -> None:
    expected = np.stack(play(started(name, SPACES["stump_tracks"]), 250))
    request.getfixturevalue("unusual_torch")
    before = torch.get_rng_state()
    teacher = started(name, SPACES["stump_tracks"])
    np.testing.assert_array_equal(np.stack(play(teacher, 250)), expected)
    teacher.probe(10)
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.get_num_threads() == 2
    assert torch.get_default_dtype() is torch.float64
    assert not torch.is_grad_enabled()


def flow(size: int, hidden: int = 8, seed: int = 0) -> RealNVP:
    return RealNVP(size, hidden, torch.Generator().manual_seed(seed))


def noise(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, dtype=DTYPE, generator=torch.Generator().manual_seed(seed))


def conditions(count: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(count, dtype=DTYPE, generator=torch.Generator().manual_seed(seed))


def rough(size: int) -> RealNVP:
    """A flow far from the identity, with which every flow begins."""
    rough = flow(size)
    with torch.no_grad():
        for index, weight in enumerate(rough.parameters()):
            weight += 0.2 * noise(*weight.shape, seed=index)
    return rough


@cache
def fitted(size: int, steps: int = 100) -> RealNVP:
    """A flow that has learned to put points near its condition: N(0.25 + 0.5 c, 0.08)."""
    learned = flow(size)
    optimiser = torch.optim.Adam(learned.parameters(), 1e-2)
    for step in range(steps):
        condition = conditions(100, step)
        points = 0.25 + 0.5 * condition[:, None] + 0.08 * noise(100, size, seed=step)
        descend(optimiser, -learned.inverse(points, condition)[1].mean())
    return learned


@pytest.mark.parametrize("size", [1, 2, 3, 20])
def test_the_inverse_leads_back_with_the_same_density(size: int) -> None:
    setter, latents, condition = rough(size), noise(50, size), conditions(50)
    with torch.no_grad():
        points, log_density = setter(latents, condition)
        back, same = setter.inverse(points, condition)
    assert points.min() > FACE_DISTANCE
    assert points.max() < 1 - FACE_DISTANCE
    torch.testing.assert_close(back, latents, rtol=0, atol=1e-8)
    torch.testing.assert_close(same, log_density, rtol=0, atol=1e-8)


@pytest.mark.parametrize("size", [1, 2, 5])
def test_the_density_follows_from_the_jacobian_that_autograd_finds(size: int) -> None:
    setter, latents, condition = rough(size), noise(6, size), conditions(6)
    _, log_density = setter(latents, condition)
    for row in range(6):
        own = condition[row : row + 1]
        jacobian = torch.autograd.functional.jacobian(
            lambda z, own=own: setter(z[None], own)[0][0], latents[row]
        )
        normal = torch.distributions.Normal(0.0, 1.0).log_prob(latents[row]).sum()
        expected = normal - torch.linalg.slogdet(jacobian).logabsdet
        torch.testing.assert_close(log_density[row], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("size", "condition"),
    [(1, 0.1), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((1, 0.8), (2, 0.1), (2, 0.8)))],
)
def test_the_density_integrates_to_one(size: int, condition: float) -> None:
    setter, count = fitted(size, steps=30), 100
    middles = (torch.arange(count, dtype=DTYPE) + 0.5) / count
    grid = torch.cartesian_prod(*[middles] * size).reshape(-1, size)
    with torch.no_grad():
        _, log_density = setter.inverse(grid, torch.full((len(grid),), condition, dtype=DTYPE))
    assert log_density.exp().mean().item() == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("size", [1, 2])
@pytest.mark.slow
def test_it_learns_where_a_condition_belongs(size: int) -> None:
    setter = fitted(size)
    for condition in (0.1, 0.9):
        with torch.no_grad():
            points, _ = setter(noise(500, size, seed=1), torch.full((500,), condition, dtype=DTYPE))
        np.testing.assert_allclose(points.mean(dim=0), 0.25 + 0.5 * condition, atol=0.06)
        np.testing.assert_allclose(points.std(dim=0), 0.08, atol=0.05)


def test_it_begins_as_a_sigmoid_of_its_noise() -> None:
    latents = noise(20, 3)
    points, _ = flow(3)(latents, conditions(20))
    torch.testing.assert_close(points, torch.sigmoid(latents))


def test_far_latents_stay_inside_with_finite_slopes() -> None:
    setter, latents = rough(2), 1e6 * noise(20, 2)
    points, log_density = setter(latents, conditions(20))
    assert points.min() >= FACE_DISTANCE - 1e-12
    assert points.max() <= 1 - FACE_DISTANCE + 1e-12
    (points.sum() + log_density.sum()).backward()
    assert all(torch.isfinite(weight.grad).all() for weight in setter.parameters())


def test_slow_softplus_is_positive_and_rises() -> None:
    values = slow_softplus(torch.linspace(-1e3, 1e3, 10_001, dtype=DTYPE))
    assert values.min() > 0
    assert torch.all(values.diff() > 0)
    assert slow_softplus(torch.tensor(1e3, dtype=DTYPE)).item() == pytest.approx(1e3, rel=1e-3)

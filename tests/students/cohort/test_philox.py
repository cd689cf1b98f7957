"""Random numbers by counter, against Random123's known answers and the moments of their distributions."""

import pytest
import torch

from tma_ray.students.cohort.device import (
    Purpose,
    integers_below,
    philox,
    standard_normals,
    words,
    words_of,
)

ONES = 0xFFFFFFFF
PI = (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344)


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        ((0,) * 4, (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((ONES,) * 4, (ONES, ONES), (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (PI, (0xA4093822, 0x299F31D0), (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1)),
    ],
)
def test_known_answers(counter, key, answer):
    drawn = philox(tuple(map(torch.tensor, counter)), tuple(map(torch.tensor, key)))
    assert tuple(drawn.tolist()) == answer


def test_words_are_those_of_the_counter_whatever_the_other_runs():
    """Counter: low word of the number, position, high word, purpose; the count cuts the last block."""
    key, number = 0x123456789ABCDEF0, 2**40 + 7
    keys = torch.tensor([words_of(5), words_of(key)])
    drawn = words(keys, torch.tensor([3, number]), Purpose.NOISE, 11)
    low, high, purpose = map(torch.tensor, (*words_of(number), int(Purpose.NOISE)))
    counters = low, torch.arange(3), high, purpose
    alone = philox(counters, tuple(torch.tensor(word) for word in words_of(key)))
    assert drawn.shape == (2, 11)
    assert torch.equal(drawn[1], alone.flatten()[:11])
    assert words_of(key) == (0x9ABCDEF0, 0x12345678)


def test_integers_are_uniform_below_each_runs_limit():
    drawn = words(torch.tensor([[1, 2], [3, 4]]), torch.tensor([0, 9]), Purpose.BATCH, 40_000)
    few, many = integers_below(torch.tensor([7, 2_000_000]), drawn)
    counts = torch.bincount(few, minlength=7).double()
    assert counts.shape == (7,)
    assert (counts - 40_000 / 7).square().sum() / (40_000 / 7) < 22.5  # 0.1 % of chi-square with 6 degrees
    assert many.min() >= 0
    assert many.max() < 2_000_000
    assert (many.double().mean() / 2_000_000 - 0.5).abs() < 4 / (12 * 40_000) ** 0.5
    extremes = integers_below(torch.tensor([2**31 - 1]), torch.tensor([[0, ONES]]))
    assert extremes.tolist() == [[0, 2**31 - 2]]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_normals_have_the_moments_of_independent_ones(dtype):
    drawn = words(torch.tensor([[1, 2]]), torch.tensor([3]), Purpose.NOISE, 200_000)
    (normals,) = standard_normals(drawn, dtype).double()
    for power, moment, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        error = normals.pow(power).mean() - moment
        assert error.abs() < 4 * (variance / len(normals)) ** 0.5
    for step in (1, 2, 3, 4):
        assert (normals[step:] * normals[:-step]).mean().abs() < 4 / len(normals) ** 0.5
    edges = standard_normals(torch.tensor([[0, 0, ONES, ONES]]), dtype)
    assert torch.isfinite(edges).all()
    assert 6 < edges.abs().max() < 7

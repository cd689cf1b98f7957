"""What stacked learners are made of: padded layouts, random numbers by counter, and the replay memory."""

import numpy as np
import pytest
import torch

from tma_ray.students.cohort.device import Purpose, integers_below, philox, standard_normals, words, words_of
from tma_ray.students.cohort.networks import PaddedLayout, stacked_pass, twin_pass
from tma_ray.students.cohort.replay import StackedReplay
from tma_ray.students.mlp.layout import Layout
from tma_ray.students.mlp.network import forward, split

PLAIN = Layout((5, 20, 9, 3))


def test_sizes_are_multiples_and_outputs_are_not_padded():
    layout = PaddedLayout.of(PLAIN, others=3)
    assert layout.padded.sizes == (8, 32, 16, 3)
    assert layout.length % 16 == 0
    places = layout.columns()
    assert len(np.unique(places)) == len(places) == PLAIN.parameters + 3
    assert places.max() < layout.length
    assert PaddedLayout.of(Layout((24, 400, 300, 8))).padded.sizes == (24, 400, 304, 8)


def test_padded_networks_are_the_plain_ones():
    layout, generator = PaddedLayout.of(PLAIN), torch.Generator().manual_seed(0)
    plain = torch.randn(4, PLAIN.parameters, generator=generator, dtype=torch.float64)
    inputs = torch.randn(4, 6, 5, generator=generator, dtype=torch.float64)
    padded = torch.zeros(4, layout.length, dtype=torch.float64)
    padded[:, layout.columns()] = plain
    expected = forward(split(plain, PLAIN), inputs)
    outputs = stacked_pass(padded.requires_grad_(), layout, inputs, torch.float64)
    torch.testing.assert_close(outputs, expected, rtol=1e-12, atol=1e-12)
    (gradient,) = torch.autograd.grad(outputs.square().sum(), padded)
    gradient[:, layout.columns()] = 0
    assert not gradient.any()


def test_both_critics_of_a_pair_have_a_column_of_values():
    layout, generator = PaddedLayout.of(Layout((5, 16, 1))), torch.Generator().manual_seed(0)
    pairs = torch.randn(3, 2, layout.length, generator=generator)
    inputs = torch.randn(3, 6, 5, generator=generator)
    values = twin_pass(pairs, layout, inputs, torch.float32)
    assert values.shape == (3, 6, 2)
    for column in range(2):
        alone = stacked_pass(pairs[:, column], layout, inputs, torch.float32)
        torch.testing.assert_close(values[..., column], alone[..., 0])


def test_gradients_by_the_inputs_are_autograds_where_rows_without_one_are_left_out():
    layout, generator = PaddedLayout.of(Layout((5, 20, 9, 1))), torch.Generator().manual_seed(0)
    pairs = torch.zeros(3, 2, layout.length, dtype=torch.float64)
    shape = (3, 2, layout.plain.parameters)
    pairs[..., layout.columns()] = torch.randn(*shape, generator=generator, dtype=torch.float64)
    inputs = torch.randn(3, 40, 5, generator=generator, dtype=torch.float64).requires_grad_()
    gradients = []
    for parameters in (pairs, pairs.clone().requires_grad_()):
        values = twin_pass(parameters, layout, inputs, torch.float64).min(dim=-1).values
        gradients += torch.autograd.grad(values.square().sum(), inputs)
    assert gradients[0].any(dim=-1).double().mean() > 0.9
    torch.testing.assert_close(*gradients, rtol=1e-12, atol=1e-12)


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


CPU = torch.device("cpu")
WIDTH, CAPACITY = 3, 40


def episode(rng, length, start=None):
    observations = rng.normal(size=(length + 1, 2)).astype(np.float32)
    if start is not None:
        observations[0] = start
    actions = rng.uniform(-1, 1, (length, 1)).astype(np.float32)
    return observations, actions, rng.normal(size=length).astype("f4")


def listed(observations, actions, rewards, terminated):
    last = len(rewards) - 1
    return [
        (*observations[i], *actions[i], *observations[i + 1], float(terminated and i == last), rewards[i])
        for i in range(len(rewards))
    ]


def newest_first(replay, model):
    """All transitions of all slots as the replay gives them by age."""
    ages = torch.arange(CAPACITY).expand(WIDTH, CAPACITY)
    ages = torch.minimum(ages, replay.kept[:, None] - 1)
    batch = replay.gather(replay.newest(ages), torch.float32)
    rows = torch.cat(batch, dim=-1).numpy()
    return [rows[slot, : len(model[slot])] for slot in range(WIDTH)]


def assert_same(replay, model):
    kept = [transitions[::-1][:CAPACITY] for transitions in model]
    assert replay.kept.tolist() == [max(1, len(own)) for own in kept]
    for own, expected in zip(newest_first(replay, kept), kept, strict=True):
        np.testing.assert_array_equal(own, np.array(expected, np.float32).reshape(own.shape))


@pytest.mark.parametrize("longest", [1, 3, 30, 100], ids=["single steps", "short", "long", "over capacity"])
def test_it_keeps_the_newest_transitions_of_each_run(longest):
    """Around the ring several times; episodes of a step need two rows each, for which the memory grows."""
    rng, replay = np.random.default_rng(longest), StackedReplay(WIDTH, CAPACITY, (2, 1), CPU)
    model, lasts = [[] for _ in range(WIDTH)], [None] * WIDTH
    for _ in range(max(30, 600 // longest)):
        slot, terminated = int(rng.integers(WIDTH - 1)), bool(rng.random() < 0.3)
        goes_on = rng.random() < 0.3
        parts = episode(rng, int(rng.integers(1, longest + 1)), lasts[slot])
        replay.store(slot, *parts, terminated and not goes_on)
        model[slot] += listed(*parts, terminated and not goes_on)
        lasts[slot] = parts[0][-1] if goes_on else None
        assert_same(replay, model)
    assert max(map(len, model)) > 2 * CAPACITY
    assert not model[WIDTH - 1]
    assert (replay.moves > 0) == (longest < 30)
    replay.clear(0)
    model[0] = []
    assert_same(replay, model)


def test_pieces_fill_another_memory_with_the_same_transitions():
    rng, replay = np.random.default_rng(0), StackedReplay(WIDTH, CAPACITY, (2, 1), CPU)
    model = []
    for number in range(12):
        parts = episode(rng, 7)
        replay.store(0, *parts, number % 2 == 0)
        model += listed(*parts, number % 2 == 0)
    other = StackedReplay(WIDTH, CAPACITY, (2, 1), CPU)
    other.store(2, *episode(rng, 9), True)
    pieces = list(replay.pieces(0))
    assert [len(piece[2]) for piece in pieces] == [5, *[7] * 5]  # five episodes and most of a sixth
    other.clear(2)
    for piece in pieces:
        other.store(2, *piece)
    assert_same(other, [[], [], model])
    for before, after in zip(pieces, other.pieces(2), strict=True):
        for own, theirs in zip(before, after, strict=True):
            np.testing.assert_array_equal(own, theirs)
    parts = episode(rng, 11)
    other.store(2, *parts, False)
    assert_same(other, [[], [], model + listed(*parts, False)])


def test_an_empty_slot_has_no_pieces():
    replay = StackedReplay(WIDTH, CAPACITY, (2, 1), CPU)
    assert not list(replay.pieces(1))
    assert_same(replay, [[], [], []])

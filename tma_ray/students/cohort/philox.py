"""Random numbers by counter: Philox4x32-10 (Salmon et al., SC 2011) in torch's 64-bit integers.

What is drawn depends on nothing but a key and a counter: not on what else is drawn, nor on the device.
Torch multiplies no unsigned numbers of 32 bits, so words are int64 in [0, 2^32).
"""

from __future__ import annotations

import math
from enum import IntEnum

import torch

ROUNDS = 10

_WORD = 0xFFFFFFFF
_MULTIPLIERS = 0xD2511F53, 0xCD9E8D57
_KEY_STEPS = 0x9E3779B9, 0xBB67AE85


class Purpose(IntEnum):
    """Use of numbers: those of different uses are independent.

    Attributes:
        BATCH: transitions of a batch.
        NOISE: of actions in an update.
        VALUES: of actions that state values average over.
    """

    BATCH = 0
    NOISE = 1
    VALUES = 2


def words_of(number: int) -> tuple[int, int]:
    """Returns the low and the high 32 bits of a `number` of 64 bits."""
    return number & _WORD, number >> 32 & _WORD


def philox(counters: tuple[torch.Tensor, ...], keys: tuple[torch.Tensor, torch.Tensor]) -> torch.Tensor:
    """Returns four random words for each counter, in a new last axis (..., 4).

    Args:
        counters: four words, least significant first; all broadcast with one another and with `keys` (...).
        keys: two words, likewise.
    """
    c0, c1, c2, c3 = counters
    k0, k1 = keys
    for _ in range(ROUNDS):
        (high0, low0), (high1, low1) = (_product(c, m) for c, m in zip((c0, c2), _MULTIPLIERS, strict=True))
        c0, c1, c2, c3 = high1 ^ c1 ^ k0, low1, high0 ^ c3 ^ k1, low0
        k0, k1 = (k0 + _KEY_STEPS[0]) & _WORD, (k1 + _KEY_STEPS[1]) & _WORD
    return torch.stack((c0, c1, c2, c3), dim=-1)


def words(keys: torch.Tensor, numbers: torch.Tensor, purpose: Purpose, count: int) -> torch.Tensor:
    """Returns random words (k, count) for the update `numbers` (k,) of runs with `keys` (k, 2)."""
    blocks = torch.arange(-(-count // 4), device=keys.device)
    low, high = (numbers & _WORD)[:, None], (numbers >> 32 & _WORD)[:, None]
    # the block is the second word, which no round multiplies: torch's compiler would do that in 32 bits
    counters = low, blocks, high, torch.full_like(low, int(purpose))
    drawn = philox(counters, (keys[:, :1], keys[:, 1:])).flatten(1)
    return drawn[:, :count]


def integers_below(limits: torch.Tensor, drawn: torch.Tensor) -> torch.Tensor:
    """Returns integers (k, n) in [0, limit) from random words `drawn` (k, n); `limits` (k,) are under 2^31.

    A number is at most 2^-32 more or less likely than it should be.
    """
    return drawn * limits[:, None] >> 32


def standard_normals(drawn: torch.Tensor, dtype: torch.dtype) -> torch.Tensor:
    """Returns standard normals (k, n) from random words `drawn` (k, n), n even (Box and Muller)."""
    halves = drawn.view(len(drawn), -1, 2).to(dtype)
    radii = (-2 * ((halves[..., 0] + 1) * 2.0**-32).log()).sqrt()
    angles = halves[..., 1] * (2 * math.pi * 2.0**-32)
    return torch.stack((radii * angles.cos(), radii * angles.sin()), dim=-1).flatten(1)


def _product(word: torch.Tensor, multiplier: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Returns the high and the low word of the product, made of halves: in one piece it has 64 bits.

    Signed numbers of 64 bits would overflow, which compilers of C++ assume never to happen.
    """
    lower, upper = (word & 0xFFFF) * multiplier, (word >> 16) * multiplier
    upper = upper + (lower >> 16)
    return upper >> 16, (upper & 0xFFFF) << 16 | lower & 0xFFFF

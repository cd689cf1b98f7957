"""The seeds of a student's own random streams. Imports no torch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class StudentStreams(NamedTuple):
    """Independent seeds for the parts of a student; the order of the fields is the order of spawning.

    Attributes:
        networks: initial weights, and actions sampled in updates.
        exploration: actions.
        batches: mini-batches.
        values: state values.
    """

    networks: np.random.SeedSequence
    exploration: np.random.SeedSequence
    batches: np.random.SeedSequence
    values: np.random.SeedSequence

    @classmethod
    def of(cls, seed: np.random.SeedSequence) -> StudentStreams:
        """Returns the streams of the student with `seed`, which does not change."""
        return cls(*_children(seed, len(cls._fields)))


def update_key(seed: np.random.SeedSequence) -> int:
    """Returns the 64-bit key of the draws of a student's updates in a cohort."""
    place = len(StudentStreams._fields)
    return int(_children(seed, place + 1)[place].generate_state(1, np.uint64)[0])


def _children(seed: np.random.SeedSequence, count: int) -> list[np.random.SeedSequence]:
    return [np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k)) for k in range(count)]

"""The random streams of a run: one SeedSequence, spawned in a fixed order."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from tma_ray.runs.spec import RunSpec
from tma_ray.tasks import ShuffledSpace, TestSet


@dataclass(frozen=True)
class Streams:
    """Independent seeds for the parts of a run; the order of the fields is the order of spawning."""

    teacher: np.random.SeedSequence
    environment: np.random.SeedSequence
    student: np.random.SeedSequence
    trials: np.random.SeedSequence

    @classmethod
    def of(cls, spec: RunSpec) -> Streams:
        """Returns the streams of a run, from the hash of its effective spec and its seed."""
        return cls(*np.random.SeedSequence([spec.entropy, spec.seed]).spawn(4))


def placement_generator(spec: RunSpec) -> np.random.Generator:
    """Returns what places the challenge's random parts: the same for all teachers of one seed."""
    words = [_hash(f"{spec.environment}/{spec.challenge}/{spec.repeat}"), spec.seed]
    return np.random.default_rng(np.random.SeedSequence(words))


def landscape_of(spec: RunSpec, placement: np.random.Generator) -> ShuffledSpace | None:
    """Returns where the teacher's tasks lie in the world, None if its space is not shuffled.

    Args:
        spec: of the run.
        placement: what `placement_generator` returned; the shuffle is its first draw.
    """
    return ShuffledSpace.shuffle(spec.task_space, placement, spec.cuts) if spec.cuts else None


def evaluation_seeds(test_set: TestSet) -> list[int]:
    """Returns the seed of each test task's world: every evaluation of every run meets the same worlds."""
    sequences = (np.random.SeedSequence([_hash(test_set.digest), index]) for index in range(len(test_set)))
    return [int(sequence.generate_state(1)[0] >> 1) for sequence in sequences]


def _hash(text: str) -> int:
    return int(hashlib.sha256(text.encode()).hexdigest()[:16], 16)

"""Replay buffer without duplicate observations, with correct bootstrapping at time limits."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import ReplayBufferSamples

from tma_ray.students.base import Observations, Transition

SEGMENT_ROWS = 100_000  # rows per file: about 12 MB with observations of length 24 and actions of length 4

INDEX_FILE = "replay.npz"

_COLUMNS = ("_observations", "_actions", "_rewards", "_terminated", "_ending")
_COUNTERS = ("_row", "_size", "_filled", "_first_ending", "_next_ending", "_added")


class ReplayBuffer:
    """Ring buffer of transitions; a transition's next observation is the observation of the next row.

    Next observations at the end of an episode are stored in a second, small ring, so that truncated episodes
    bootstrap from their last observation; stable-baselines3's buffer cannot do that while storing
    observations once. Memory is allocated as it fills.

    It replaces stable-baselines3's buffer, whose updates only call `sample`.
    """

    def __init__(
        self,
        capacity: int,
        observation_size: int,
        action_size: int,
        generator: np.random.Generator,
        device: torch.device,
    ) -> None:
        self._rows = capacity + 1  # one more, for the newest transition's next observation
        self._generator = generator
        self._device = device
        self._observations = np.zeros((self._rows, observation_size), dtype=np.float32)
        self._actions = np.zeros((self._rows, action_size), dtype=np.float32)
        self._rewards = np.zeros(self._rows, dtype=np.float32)
        self._terminated = np.zeros(self._rows, dtype=np.bool_)
        self._ending = np.zeros(self._rows, dtype=np.int32)  # number of the entry in `_endings`, 0 for none
        self._added = 0  # number of transitions ever added
        self.clear()

    def __len__(self) -> int:
        return self._size

    def clear(self) -> None:
        """Discard all transitions."""
        self._row = 0  # row for the next transition
        self._size = 0
        self._filled = 0  # number of rows ever written
        self._saved = 0  # `_added` at the last save or load, or 0 if none since `clear`
        self._endings = np.empty((1, self._observations.shape[1]), dtype=np.float32)
        self._first_ending, self._next_ending = 1, 1  # `_endings` has the numbers [first, next)

    def add(self, transition: Transition, action: NDArray[np.float32]) -> None:
        """Store `transition` with its `action` (a,) scaled to [-1, 1]; if full, replace the oldest."""
        row = self._row
        following = row + 1 if row + 1 < self._rows else 0
        if self._size == self._rows - 1:  # the next observation will overwrite the oldest transition
            self._first_ending += bool(self._ending[following])
            self._size -= 1
        if self._size and not (self._observations[row] == transition.observation).all():
            self._keep_ending(row)
        self._observations[row] = transition.observation
        self._actions[row] = action
        self._rewards[row] = transition.reward
        self._terminated[row] = transition.terminated
        self._ending[row] = 0
        self._observations[following] = transition.next_observation
        self._row = following
        self._size += 1
        self._added += 1
        self._filled = max(self._filled, row + 1)

    def extend(
        self,
        observations: Observations,
        actions: NDArray[np.float32],
        rewards: NDArray[np.float32],
        terminated: bool,
    ) -> None:
        """Store n consecutive transitions of an episode, like n calls to `add`.

        Args:
            observations: observations of all transitions, and the last next one (n + 1, o).
            actions: actions in [-1, 1] (n, a).
            rewards: rewards (n,).
            terminated: True if the last transition ended in a terminal state.
        """
        count, row = len(actions), self._row
        if self._size + count >= self._rows or row + count >= self._rows:  # would wrap or overwrite rows
            for k in range(count):
                last = terminated and k == count - 1
                step = Transition(
                    observations[k], actions[k], float(rewards[k]), observations[k + 1], last, False
                )
                self.add(step, actions[k])
            return
        if self._size and not (self._observations[row] == observations[0]).all():
            self._keep_ending(row)
        rows = slice(row, row + count)
        self._observations[row : row + count + 1] = observations
        self._actions[rows] = actions
        self._rewards[rows] = rewards
        self._terminated[rows] = False
        self._terminated[row + count - 1] = terminated
        self._ending[rows] = 0
        self._row = row + count
        self._size += count
        self._added += count
        self._filled = max(self._filled, self._row)

    def pieces(self) -> Iterator[tuple[Observations, NDArray[np.float32], NDArray[np.float32], bool]]:
        """Yield the transitions of every episode, oldest first, as arguments of `extend`."""
        rows = (self._row - np.arange(self._size, 0, -1)) % self._rows
        ends = self._terminated[rows] | (self._ending[rows] > 0)
        for piece in np.split(rows, ends.nonzero()[0] + 1):
            if len(piece):
                last = self._next_observations(piece[-1:])
                observations = np.concatenate((self._observations[piece], last))
                terminated = bool(self._terminated[piece[-1]])
                yield observations, self._actions[piece], self._rewards[piece], terminated

    def sample(self, batch_size: int, env: None = None) -> ReplayBufferSamples:
        """Return `batch_size` transitions, drawn uniformly with replacement, as float32 tensors."""
        assert env is None, "a normalising environment of stable-baselines3 is not used"
        ages = self._generator.integers(1, self._size + 1, size=batch_size)
        rows = (self._row - ages) % self._rows
        batch = (
            self._observations[rows],
            self._actions[rows],
            self._next_observations(rows),
            self._terminated[rows, None].astype(np.float32),
            self._rewards[rows, None],
        )
        return ReplayBufferSamples(*(torch.from_numpy(column).to(self._device) for column in batch))

    def save(self, folder: Path, incremental: bool = False) -> tuple[str, ...]:
        """Write the filled rows in segments, and return the names of the segments left out.

        If `incremental`, segments unchanged since the last save or load are left out.
        """
        changed: set[int] | None = None
        if incremental and self._saved:
            new = min(self._added - self._saved, self._rows)
            # new rows and those directly before and after them, which `add` also changes
            touched = np.arange(self._row - new - 1, self._row + 1) % self._rows
            changed = set((touched // SEGMENT_ROWS).tolist())
        used, unchanged = min(self._filled + 1, self._rows), []
        for number in range(math.ceil(used / SEGMENT_ROWS)):
            name = f"replay-{number:04d}.npz"
            if changed is not None and number not in changed:
                unchanged.append(name)
                continue
            rows = slice(number * SEGMENT_ROWS, min(used, (number + 1) * SEGMENT_ROWS))
            columns: dict[str, Any] = {column: getattr(self, column)[rows] for column in _COLUMNS}
            np.savez(folder / name, **columns)
        kept = np.arange(self._first_ending, self._next_ending)
        counters: dict[str, Any] = {name: np.int64(getattr(self, name)) for name in _COUNTERS}
        np.savez(folder / INDEX_FILE, endings=self._endings[kept % len(self._endings)], **counters)
        self._saved = self._added
        return tuple(unchanged)

    def load(self, folder: Path) -> None:
        """Load the transitions saved by a buffer of the same sizes."""
        for number, path in enumerate(sorted(folder.glob("replay-*.npz"))):
            start = number * SEGMENT_ROWS
            with np.load(path) as segment:
                for name in _COLUMNS:
                    getattr(self, name)[start : start + len(segment[name])] = segment[name]
        with np.load(folder / INDEX_FILE) as index:
            endings: Observations = index["endings"]
            for name in _COUNTERS:
                setattr(self, name, int(index[name]))
        self._endings = np.empty((max(1, len(endings)), self._observations.shape[1]), dtype=np.float32)
        self._endings[np.arange(self._first_ending, self._next_ending) % len(self._endings)] = endings
        self._saved = self._added

    def _next_observations(self, rows: NDArray[np.int64]) -> Observations:
        following = self._observations[(rows + 1) % self._rows]
        endings = self._ending[rows]
        ended = endings.nonzero()[0]
        following[ended] = self._endings[endings[ended] % len(self._endings)]
        return following

    def _keep_ending(self, row: int) -> None:
        """Move the newest transition's next observation from `row` to the ring of last observations."""
        if self._next_ending - self._first_ending == len(self._endings):
            kept = np.arange(self._first_ending, self._next_ending)
            grown = np.empty((2 * len(self._endings), self._endings.shape[1]), dtype=np.float32)
            grown[kept % len(grown)] = self._endings[kept % len(self._endings)]
            self._endings = grown
        self._endings[self._next_ending % len(self._endings)] = self._observations[row]
        self._ending[row - 1] = self._next_ending  # for row 0, index -1 is the last row
        self._next_ending += 1

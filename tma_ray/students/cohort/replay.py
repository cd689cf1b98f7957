"""Replay buffers of many runs on the learner's device, without duplicate observations."""

from collections import deque
from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.cohort.device import empty, upload
from tma_ray.students.cohort.learner import narrowed
from tma_ray.students.sac import Transitions


class _Track:
    """Index of the rows that hold a run's transitions; both are numbered from when the run joined."""

    def __init__(self) -> None:
        self.count, self.tail = 0, 0  # numbers of transitions and rows added so far
        self.pieces: deque[tuple[int, int, int]] = deque()
        """First transition, first row, and number of transitions of each stored piece."""

    def head(self, kept: int) -> int:
        """Return the first row of the newest `kept` transitions."""
        oldest = self.count - kept
        for first, row, length in self.pieces:
            if oldest < first + length:
                return row + max(0, oldest - first)
        return self.tail


class StackedReplay:
    """Ring buffers of k runs; a transition's next observation is stored in the following row.

    An episode of n transitions takes n + 1 rows. If short episodes exceed the spare rows, the memory of
    all runs is reallocated. On a CPU, memory is allocated as it fills.

    Attributes:
        kept: transitions kept of each run, at least 1 for idle slots (k,).
        counts: transitions since the run joined (k,).
        moves: number of reallocations.
    """

    def __init__(self, width: int, capacity: int, sizes: tuple[int, int], device: torch.device) -> None:
        self._capacity, (self._o, self._a), self._device = capacity, sizes, device
        self._tracks = [_Track() for _ in range(width)]
        self._rows = capacity + capacity // 32 + 8
        self._table = empty((width, capacity), torch.int32, device)
        self._memory = empty((width, self._rows, self._o + self._a + 2), torch.float32, device)
        self.kept = torch.ones(width, dtype=torch.int64, device=device)
        self.counts = torch.ones(width, dtype=torch.int64, device=device)
        self.moves = 0

    def clear(self, slot: int) -> None:
        """Discard all transitions of the run in `slot`."""
        self._tracks[slot] = _Track()
        self._memory[slot, :2].zero_()
        self._table[slot, :1].zero_()
        self.counts[slot].fill_(1)
        self.kept[slot].fill_(1)

    def store(
        self,
        slot: int,
        observations: NDArray[np.float32],
        actions: NDArray[np.float32],
        rewards: NDArray[np.float32],
        terminated: bool,
    ) -> None:
        """Append consecutive transitions to the buffer of the run in `slot`, as in `ReplayBuffer.extend`."""
        length, stored = len(rewards), min(len(rewards), self._capacity)
        if not length:
            return
        packed = np.zeros((stored + 1, self._memory.shape[2]), dtype=np.float32)
        packed[:, : self._o] = observations[length - stored :]
        packed[:-1, self._o : -2], packed[:-1, -2] = actions[length - stored :], rewards[length - stored :]
        packed[-2, -1] = terminated
        track = self._tracks[slot]
        needed = track.tail + stored + 1 - track.head(max(0, self._capacity - stored))
        if needed > self._rows:
            self._grow(max(needed, self._rows + self._rows // 4))
            track = self._tracks[slot]
        first, row = track.count, track.tail
        track.pieces.append((first, row, stored))
        track.count, track.tail = first + stored, row + stored + 1
        while track.pieces[0][0] + track.pieces[0][2] <= track.count - self._capacity:
            track.pieces.popleft()
        self._write(self._memory[slot], row, upload(packed, self._device))
        rows = torch.arange(row, row + stored, device=self._device) % self._rows
        self._write(self._table[slot], first, rows.to(torch.int32))
        self.counts[slot].fill_(track.count)
        self.kept[slot].fill_(min(track.count, self._capacity))

    def pieces(
        self, slot: int
    ) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], bool]]:
        """Yield the transitions of the run in `slot`, oldest first, as arguments of `store`."""
        track = self._tracks[slot]
        head = track.head(min(track.count, self._capacity))
        rows = torch.arange(head, track.tail, device=self._device) % self._rows
        packed = self._memory[slot].index_select(0, rows).cpu().numpy()
        for _, row, length in track.pieces:
            piece = packed[max(row, head) - head : row + length + 1 - head]
            yield piece[:, : self._o], piece[:-1, self._o : -2], piece[:-1, -2], bool(piece[-2, -1] > 0)

    def row(self, slot: int) -> "StackedReplay":
        """Return a view restricted to the run in `slot`, for sampling; valid until the next reallocation."""
        return narrowed(self, slot, "kept", "counts", "_table", "_memory")

    def newest(self, ages: torch.Tensor) -> torch.Tensor:
        """Return the ring indices (k, n) of transitions given by their `ages` (k, n), 0 for the newest."""
        return (self.counts[:, None] - 1 - ages) % self._capacity

    def gather(self, ring: torch.Tensor, dtype: torch.dtype) -> Transitions:
        """Return the transitions at ring indices (k, n)."""
        (width, count), rows = ring.shape, self._table.gather(1, ring).long()
        following = (rows + 1) % self._rows
        base = torch.arange(width, device=self._device)[:, None] * self._rows
        memory = self._memory.flatten(0, 1)
        before = memory.index_select(0, (rows + base).flatten()).view(width, count, -1).to(dtype)
        after = memory.index_select(0, (following + base).flatten()).view(width, count, -1).to(dtype)
        actions, rewards, terminated = torch.split(before[..., self._o :], [self._a, 1, 1], dim=-1)
        return Transitions(before[..., : self._o], actions, after[..., : self._o], terminated, rewards)

    def _write(self, memory: torch.Tensor, start: int, values: torch.Tensor) -> None:
        """Write `values` to the ring buffer `memory`, from the index `start` modulo its length."""
        start %= len(memory)
        fits = min(len(values), len(memory) - start)
        memory[start : start + fits].copy_(values[:fits])
        if fits < len(values):
            memory[: len(values) - fits].copy_(values[fits:])

    def _grow(self, rows: int) -> None:
        kept = [list(self.pieces(slot)) for slot in range(len(self._tracks))]
        width, _, size = self._memory.shape
        self._rows = rows
        self._memory = empty((width, rows, size), torch.float32, self._device)
        for slot, pieces in enumerate(kept):
            self.clear(slot)
            for piece in pieces:
                self.store(slot, *piece)
        self.moves += 1

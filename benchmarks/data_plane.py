"""Time of an exchange between rollout worker and learner: by socket and shared memory, or by calls of Ray.

    python benchmarks/data_plane.py

A rollout worker sends an episode of SAC (300 steps of the classic bipedal) and receives weights (hidden
layers of 400 and 300 units). Both are processes of this machine, without learning. Prints the milliseconds
until the weights arrive, and the learner's processor time.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import ray

from tma_ray.campaign.cluster.connection import connect
from tma_ray.students import Learner
from tma_ray.students.cohort.server import LearnerServer
from tma_ray.students.rollout_workers import CohortSettings
from tma_ray.students.rollout_workers.link import LearnerLink

STEPS, OBSERVATION, ACTION, HIDDEN = 300, 24, 4, (400, 300)

WARM_UP = 20
"""Number of exchanges before a measurement."""


def experience() -> tuple[Any, ...]:
    """Return the experience of an episode of SAC, as sent by a rollout worker."""
    observations = np.zeros((STEPS + 1, OBSERVATION), np.float32)
    return observations, np.zeros((STEPS, ACTION), np.float32), np.zeros(STEPS, np.float32), True


def weights() -> np.ndarray:
    """Return weights of the size of SAC's actor."""
    sizes = OBSERVATION, *HIDDEN, 2 * ACTION
    return np.zeros(sum((i + 1) * o for i, o in pairwise(sizes)), np.float32)


class Idle(LearnerServer):
    """Learner without updates."""

    def _join_for(self, _: Any, __: Any) -> Any:
        return weights()

    def _learn_for(self, connection: Any, posted: tuple[Any, ...], _: int) -> Any:
        mailbox = self._buffers[connection]
        mailbox.collect(posted)
        return mailbox.post((weights(),))[0]


class Learning:
    """Actor with an `Idle` learner, reached by a socket or by calls of `learn`."""

    def __init__(self, folder: str) -> None:
        self._learner, self._weights = Learner(f"{folder}/learner", b"key"), weights()
        server = Idle(self._learner, CohortSettings())
        threading.Thread(target=server.serve, args=(lambda: False,), daemon=True).start()

    def address(self) -> Learner:
        """Return the address of the learner."""
        return self._learner

    def seconds(self) -> float:
        """Return the processor time of the learner so far, s."""
        return time.process_time()

    def learn(self, _experience: tuple[Any, ...], _updates: int) -> np.ndarray:
        """Return weights."""
        return self._weights


class Playing:
    """Rollout worker without environment."""

    def socket(self, learner: Learner, count: int) -> float:
        """Return the median time of an exchange over the socket, s."""
        link, handed = LearnerLink(learner), experience()
        membership: Any = None
        link.join(membership)
        return median(lambda: link.learn(handed, STEPS // 10), count)

    def calls(self, actor: Any, count: int) -> float:
        """Return the median time of an exchange by a call of the actor, s."""
        handed = experience()
        return median(lambda: ray.get(actor.learn.remote(handed, STEPS // 10)), count)


def median(exchange: Callable[[], object], count: int) -> float:
    """Return the median time of an exchange, s."""
    for _ in range(WARM_UP):
        exchange()
    seconds = []
    for _ in range(count):
        began = time.perf_counter()
        exchange()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))


def main() -> int:
    """Measure exchanges by socket and by calls, and print the times."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=str(__doc__))
    parser.add_argument("--exchanges", type=int, default=500, help="of each kind")
    count = parser.parse_args().exchanges
    with tempfile.TemporaryDirectory() as folder:
        connect(None)
        made: Any = ray.remote(num_cpus=0)
        learner, worker = made(Learning).remote(folder), made(Playing).remote()
        address = ray.get(learner.address.remote())
        assert Path(address.address).exists()
        measured: dict[str, Callable[[], Any]] = {
            "socket and shared memory": lambda: worker.socket.remote(address, count),
            "Ray calls": lambda: worker.calls.remote(learner, count),
        }
        print("| | ms | ms of the learner's processor |\n| --- | --- | --- |")
        for name, measure in measured.items():
            before = ray.get(learner.seconds.remote())
            milliseconds = 1000 * ray.get(measure())
            used = 1000 * (ray.get(learner.seconds.remote()) - before) / (count + WARM_UP)
            print(f"| {name} | {milliseconds:.2f} | {used:.2f} |", flush=True)
    ray.shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""Measurement of several kinds of runs in processes side by side, with progress and within a time."""

from __future__ import annotations

import json
import os
import pickle
import selectors
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import IO

from rich.progress import Progress

from tma_ray.campaign.costs.speed import Source, Throughput, label_of
from tma_ray.campaign.costs.worker import Order
from tma_ray.campaign.settings import Settings
from tma_ray.commands.texts import counted
from tma_ray.runs.inputs import contents
from tma_ray.runs.spec import RunSpec
from tma_ray.terminal import terminal

POLL_SECONDS = 0.2
"""Between two looks at the time, s."""

Show = Callable[[int, int], None]
"""Takes how much is done, of how much: kernels to be compiled, in each process, and kinds to be measured."""


def measure_all(
    specs: Mapping[str, RunSpec], settings: Settings, at_once: int, patience: Mapping[str, float]
) -> dict[str, Throughput]:
    """Returns the speeds of runs by key, measured with `at_once` of them side by side.

    Where there are fewer kinds than processes, several measure the same kind, and their mean counts.

    Args:
        specs: an example of each kind, by key.
        settings: how they are executed.
        at_once: how many run at the same time.
        patience: after how many seconds a key is left out, if not measured by then; others are waited for.

    Raises:
        ValueError: a process ended; the message has the end of its error.
    """
    if not specs:
        return {}
    found: dict[str, list[Throughput]] = {key: [] for key in specs}
    with _workers(_orders(specs, settings, at_once)) as workers, _progress(specs) as show:
        began = time.monotonic()
        while missing := {key for key, each in found.items() if not each}:
            if all(time.monotonic() - began > patience.get(key, float("inf")) for key in missing):
                break
            for key, throughput in _results(workers, specs):
                found[key].append(throughput)
            counts = [selected.data.kernels for selected in workers.get_map().values()]
            compiled, kernels = map(sum, zip(*counts, strict=True))
            show(compiled + sum(map(bool, found.values())), kernels + len(found))
    return {key: _mean(each) for key, each in found.items() if each}


def _orders(specs: Mapping[str, RunSpec], settings: Settings, at_once: int) -> list[Order]:
    """Returns the work of each process: every kind goes to one, or each process has one kind."""
    keys = list(specs)
    shares = [keys[place::at_once] or [keys[place % len(keys)]] for place in range(at_once)]
    files = contents(specs.values())
    return [
        Order([(key, specs[key].to_dict()) for key in share], settings, files, sys.path) for share in shares
    ]


class _Worker:
    """A process of `worker`, its unread output, its errors, and its kernels: those compiled, and all."""

    def __init__(self, order: Order) -> None:
        self.kernels, self.unread = (0, 0), b""
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115  (closed with the process)
        threads = {"OMP_NUM_THREADS": str(order.settings.each.threads)} if order.settings.width else {}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tma_ray.campaign.costs.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            env=os.environ | threads | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        )
        assert self.process.stdin is not None
        with self.process.stdin as stream:
            pickle.dump(order, stream)

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()
        self.errors.close()

    def last_error(self) -> str:
        """Returns the last line that the process wrote as an error."""
        self.errors.seek(0)
        lines = self.errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it was ended"


@contextmanager
def _workers(orders: Sequence[Order]) -> Iterator[selectors.BaseSelector]:
    """Starts a process for each order; ends all of them."""
    started: list[_Worker] = []
    try:
        with selectors.DefaultSelector() as selector:
            for order in orders:
                started.append(_Worker(order))
                selector.register(_output(started[-1]), selectors.EVENT_READ, started[-1])
            yield selector
    finally:
        for worker in started:
            worker.end()


def _results(
    selector: selectors.BaseSelector, specs: Mapping[str, RunSpec]
) -> Iterator[tuple[str, Throughput]]:
    """Yields what processes have measured since the last call, and takes note of what they have compiled."""
    for event, _ in selector.select(POLL_SECONDS):
        worker: _Worker = event.data
        data = os.read(event.fd, 2**16)
        if not data:
            labels = ", ".join(map(label_of, specs.values()))
            raise ValueError(f"cannot measure the speed of {labels}: {worker.last_error()}")
        *lines, worker.unread = (worker.unread + data).split(b"\n")
        for record in map(json.loads, lines):
            if "kernels" in record:
                worker.kernels = record["compiled"], record["kernels"]
            else:
                values = record["throughput"]
                yield record["key"], Throughput(**{**values, "source": Source(values["source"])})


def _output(worker: _Worker) -> IO[bytes]:
    assert worker.process.stdout is not None
    return worker.process.stdout


@contextmanager
def _progress(specs: Mapping[str, RunSpec]) -> Iterator[Show]:
    """Shows on the error stream how much is done: a bar, or a line without a terminal."""
    number = counted(len(specs), "kind of run", "kinds of runs")
    console, text = terminal(stderr=True), f"measuring the speed of {number}"
    if not console.is_terminal:
        console.print(f"{text}, some seconds", highlight=False)
        yield lambda *_: None
        return
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task(text, total=len(specs))
        yield lambda done, total: progress.update(task, completed=done, total=total)


def _mean(each: Sequence[Throughput]) -> Throughput:
    first, number = each[0], len(each)
    return Throughput(
        first.label,
        sum(throughput.training for throughput in each) / number,
        sum(throughput.playing for throughput in each) / number,
        first.transition_bytes,
        first.source,
        learner=sum(throughput.learner for throughput in each) / number,
    )

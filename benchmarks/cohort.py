"""Speed of stacked learners, and independence of their slots, without Ray, in a few minutes.

    python benchmarks/cohort.py
    python benchmarks/cohort.py --device cuda --widths 16,48 --precisions highest,high,medium --compiled 0,1

For each student, width and precision, measures an update of all slots, the environment steps that it covers,
and on a processor an update of a run that learns alone; checks that a run learns the same bits alone and
beside full slots. Then plays whole runs of PPO, alone on a processor and in a full cohort, and compares the
processor time of a step and of its parts. (SAC makes up to 200 updates at the end of an episode, too many to
count its steps within a minute; the update takes 99 % of a step.) Prints the tables at the end, and writes
JSON to ``--output``. Skips measurements that would not end within ``--minutes``.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
import whole_runs
from gymnasium import spaces
from stable_baselines3.common.type_aliases import ReplayBufferSamples, RolloutBufferSamples

from tma_ray.students import ppo as student_ppo
from tma_ray.students import sac as student_sac
from tma_ray.students.cohort.ppo import PPONetworks, StackedPPO
from tma_ray.students.cohort.sac import SACNetworks, StackedSAC
from tma_ray.students.hyperparameters import MatmulPrecision, PPOHyperparameters, SACHyperparameters

SIZES = 24, 4
"""Numbers of observations and actions of the classic bipedal."""

SPACES = spaces.Box(-np.inf, np.inf, SIZES[:1], np.float32), spaces.Box(-1.0, 1.0, SIZES[1:], np.float32)

ROWS = 20_000
"""Number of transitions in each replay buffer."""

STEPS = {"sac": 10.0, "ppo": PPOHyperparameters.batch_size / PPOHyperparameters.epochs}
"""Environment steps for each update of a run."""


UPDATES = 10
"""Number of updates between two checks of the time."""

WHOLE = {"ppo"}
"""Students whose whole runs are measured."""

PREPARATION = 120.0
"""Time for whole runs of a student before their measurement, alone and in a cohort, s."""


class SAC:
    """Updates of SAC on random data, for `speed` and `independent`."""

    def stack(self, options: argparse.Namespace, width: int, precision: str, compiled: bool) -> StackedSAC:
        """Return an empty stack."""
        hyper = SACHyperparameters(matmul_precision=MatmulPrecision(precision))
        return StackedSAC(
            SIZES, hyper, width, 100_000, torch.device(options.device), **_mode(options, compiled)
        )

    def fill(self, stack: StackedSAC, slot: int, seed: int) -> None:
        """Fill a slot with networks and a replay buffer that depend only on `seed`."""
        generator = np.random.default_rng(seed)
        actor, critics, targets = (_noise(generator, part.shape) for part in stack.networks(slot)[:3])
        zeros = np.zeros_like(actor), np.zeros_like(critics)
        moments = zeros[0], zeros[0], zeros[1], zeros[1]
        stack.join(slot, SACNetworks(actor, critics, targets, *moments, 0, 0), key=seed)
        for _ in range(ROWS // 1000):
            observations = generator.standard_normal((1001, SIZES[0]), dtype=np.float32)
            actions = generator.uniform(-1, 1, (1000, SIZES[1])).astype(np.float32)
            rewards = generator.standard_normal(1000, dtype=np.float32)
            stack.store(slot, observations, actions, rewards, True)

    def alone(self) -> Callable[[], object]:
        """Return the update function of a single run."""
        size, (observation, action) = SACHyperparameters.batch_size, SIZES
        student = student_sac.SAC(*SPACES, SACHyperparameters(), np.random.SeedSequence(0))
        shapes = observation, action, observation, 1, 1
        batch = ReplayBufferSamples(*(0.1 * torch.randn(size, each) for each in shapes))
        return lambda: student.update(batch)

    def work(self, stack: StackedSAC, slot: int) -> None:
        """Request ten updates of a slot."""
        stack.owe(slot, 10)


class PPO:
    """Updates of PPO on random data; see `SAC`."""

    def stack(self, options: argparse.Namespace, width: int, precision: str, compiled: bool) -> StackedPPO:
        """Return an empty stack."""
        hyper = PPOHyperparameters(matmul_precision=MatmulPrecision(precision))
        return StackedPPO(SIZES, hyper, width, torch.device(options.device), **_mode(options, compiled))

    def fill(self, stack: StackedPPO, slot: int, seed: int) -> None:
        """Fill a slot with networks that depend only on `seed`."""
        parameters = _noise(np.random.default_rng(seed), stack.networks(slot).parameters.shape)
        zeros = np.zeros_like(parameters)
        stack.join(slot, PPONetworks(parameters, zeros, zeros, 0))

    def alone(self) -> Callable[[], object]:
        """Return the update function of a single run."""
        size = PPOHyperparameters.batch_size
        student = student_ppo.PPO(*SPACES, PPOHyperparameters(), np.random.SeedSequence(0))
        steps = [0.1 * torch.randn(size, each) for each in SIZES]
        batch = RolloutBufferSamples(*steps, *(0.1 * torch.randn(size) for _ in range(4)))
        return lambda: student.update.train_on(batch)

    def work(self, stack: StackedPPO, slot: int) -> None:
        """Store a rollout in a slot, for the updates of PPO."""
        generator, hyper = np.random.default_rng(slot), PPOHyperparameters()
        count = hyper.steps_per_update
        steps = [_noise(generator, (count, size)) for size in SIZES]
        values = _noise(generator, (4, count))
        orders = np.stack([generator.permutation(count) for _ in range(hyper.epochs)])
        stack.store(slot, (*steps, *values), orders)


STUDENTS: dict[str, Any] = {"sac": SAC(), "ppo": PPO()}


def _noise(generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return np.asarray(0.05 * generator.standard_normal(shape), np.float32)


def _mode(options: argparse.Namespace, compiled: bool) -> dict[str, Any]:
    return {"compiled": options.mode or compiled} if compiled else {}


def wait(device: torch.device) -> None:
    """Wait for pending operations of a GPU."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def advance(student: str, stack: Any, updates: int) -> None:
    """Give new work to idle slots, then update all slots."""
    for slot in np.flatnonzero(stack.owed == 0):
        STUDENTS[student].work(stack, int(slot))
    stack.advance(updates)


def speed(options: argparse.Namespace, student: str, width: int, *variant: Any) -> dict[str, Any]:
    """Measure the updates of a full stack."""
    device = torch.device(options.device)
    torch.set_num_threads(1)
    stack = STUDENTS[student].stack(options, width, *variant)
    for slot in range(width):
        STUDENTS[student].fill(stack, slot, slot)
    started = time.perf_counter()
    advance(student, stack, 2)
    wait(device)
    preparation = time.perf_counter() - started
    clock = time.process_time if device.type == "cpu" else time.perf_counter
    count, started = 0, clock()
    while clock() - started < options.seconds:
        advance(student, stack, UPDATES)
        wait(device)
        count += UPDATES
    milliseconds = 1000 * (clock() - started) / count
    alone = {} if device.type != "cpu" else {"alone_ms": round(_alone_ms(student, options.seconds), 3)}
    return {
        "student": student,
        "width": width,
        "precision": variant[0],
        "compiled": variant[1],
        "preparation_s": round(preparation, 1),
        "update_ms": round(milliseconds, 3),
        "bound_steps_s": round(1000 * width * STEPS[student] / milliseconds),
        **alone,
        "losses": stack.metrics(0),
    }


def _alone_ms(student: str, seconds: float) -> float:
    """Return the processor time of an update of a single run, in ms."""
    update = STUDENTS[student].alone()
    update()
    count, started = 0, time.process_time()
    while time.process_time() - started < seconds:
        update()
        count += 1
    return 1000 * (time.process_time() - started) / count


def independent(options: argparse.Namespace, student: str, width: int, *variant: Any) -> bool:
    """Return True if 50 updates of a slot give the same bits alone and with changing neighbours."""
    own, results = STUDENTS[student], []
    for neighbours in (False, True):
        stack = own.stack(options, width, *variant)
        own.fill(stack, 1, 7)
        for piece in range(5):
            slot = (2 + piece) % width
            if neighbours and slot != 1:
                own.fill(stack, slot, 100 + piece)
                own.work(stack, slot)
            own.work(stack, 1)
            stack.advance(10)
        results.append(stack.networks(1))
    return all(np.array_equal(one, other) for one, other in zip(*results, strict=True))


def table(rows: list[dict[str, Any]]) -> str:
    """Return the measurements as a Markdown table."""
    names = (
        "student",
        "width",
        "precision",
        "compiled",
        "update_ms",
        "alone_ms",
        "bound_steps_s",
        "independent",
    )
    lines = [f"| {' | '.join(names)} |", f"|{' --- |' * len(names)}"]
    return "\n".join(
        [*lines, *(f"| {' | '.join(str(row.get(name, '')) for name in names)} |" for row in rows)]
    )


def variants(options: argparse.Namespace) -> Iterator[tuple[str, int, str, bool]]:
    """Yield the variants to measure: student, width, precision, and True for compiled updates."""
    widths = [int(width) for width in options.widths.split(",")]
    compiled = [bool(int(flag)) for flag in options.compiled.split(",")]
    students, precisions = options.students.split(","), options.precisions.split(",")
    for flag, precision, width, student in product(compiled, precisions, widths, students):
        yield student, width, precision, flag


def longest(options: argparse.Namespace, compiled: bool) -> float:
    """Return the time limit of a variant, s; an autotuning compiler takes minutes."""
    return 3 * float(options.seconds) + (200.0 if compiled else 20.0)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=str(__doc__))
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--students", default="sac,ppo")
    parser.add_argument("--widths", default="4")
    parser.add_argument("--precisions", default="highest")
    parser.add_argument("--compiled", default="0", help="0, 1 or 0,1")
    parser.add_argument("--mode", default="", help="of torch's compiler")
    parser.add_argument("--seconds", type=float, default=2.0, help="of measurement for each variant")
    parser.add_argument("--whole", type=float, default=30.0, help="seconds of whole runs each; 0: none")
    parser.add_argument("--minutes", type=float, default=9.0, help="for all of it")
    parser.add_argument("--output", default="", help="file for the JSON")
    return parser


def main() -> int:
    """Measure all variants, and print and write the results."""
    options = parser().parse_args()
    rows: list[dict[str, Any]] = []
    deadline = time.monotonic() + 60 * options.minutes
    for variant in variants(options):
        if time.monotonic() + longest(options, variant[-1]) > deadline:
            print("no time left for", *variant, flush=True)
            continue
        try:
            row = speed(options, *variant)
            row["independent"] = independent(options, *variant)
        except Exception as error:
            names = "student", "width", "precision", "compiled"
            row = dict(zip(names, variant, strict=True)) | {
                "error": f"{type(error).__name__}: {error}"[:1500]
            }
        print(row, flush=True)
        rows.append(row)
    wholes = []
    for student in WHOLE & set(options.students.split(",")) if options.whole else ():
        if time.monotonic() + 2 * options.whole + PREPARATION > deadline:
            print("no time left for whole runs of", student, flush=True)
            continue
        width = int(options.widths.split(",")[-1])
        wholes.append(whole_runs.compare(student, width, options.device, options.whole))
        print(wholes[-1], flush=True)
    print(table(rows))
    if wholes:
        print(whole_runs.table(wholes))
    if options.output:
        Path(options.output).write_text(
            json.dumps({"updates": rows, "whole runs": wholes}, indent=1, ensure_ascii=False)
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""Speed and independence of stacked learners, without Ray, in one command of a few minutes.

    python benchmarks/cohort.py --device cuda --widths 16,48 --precisions highest,high,medium --compiled 0,1

Measures an update of all slots for each width and precision, and what it could feed in environment steps;
checks that a run learns the same bits alone and with full neighbours. Prints a table last, and writes JSON to
``--output``.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tma_ray.students.cohort.sac import SACNetworks, StackedSAC
from tma_ray.students.hyperparameters import MatmulPrecision, SACHyperparameters

SIZES = 24, 4
"""Observations and actions of the classic bipedal."""

ROWS = 20_000
"""Transitions in every replay."""


def networks(generator: np.random.Generator, stack: StackedSAC, slot: int) -> SACNetworks:
    """Returns random networks of the sizes that `stack` has."""
    like = stack.networks(slot)
    arrays = [np.asarray(0.05 * generator.standard_normal(part.shape), np.float32) for part in like[:3]]
    actor, critics, targets = arrays
    zeros = np.zeros_like(actor), np.zeros_like(critics)
    return SACNetworks(actor, critics, targets, zeros[0], zeros[0], zeros[1], zeros[1], 0, 0)


def fill(stack: StackedSAC, slot: int, seed: int) -> None:
    """Gives `slot` networks and a replay that follow from `seed`."""
    generator = np.random.default_rng(seed)
    stack.join(slot, networks(generator, stack, slot), key=seed)
    for _ in range(ROWS // 1000):
        observations = generator.standard_normal((1001, SIZES[0]), dtype=np.float32)
        actions = generator.uniform(-1, 1, (1000, SIZES[1])).astype(np.float32)
        rewards = generator.standard_normal(1000, dtype=np.float32)
        stack.store(slot, observations, actions, rewards, True)


def wait(device: torch.device) -> None:
    """Waits for what a GPU was asked to do."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def stack_of(options: argparse.Namespace, width: int, precision: str, compiled: bool) -> StackedSAC:
    """Returns an empty stack."""
    hyper = SACHyperparameters(matmul_precision=MatmulPrecision(precision))
    keywords: dict[str, Any] = {"compiled": options.mode or compiled} if compiled else {}
    return StackedSAC(SIZES, hyper, width, 100_000, torch.device(options.device), **keywords)


def speed(options: argparse.Namespace, width: int, precision: str, compiled: bool) -> dict[str, Any]:
    """Measures updates of a full stack."""
    device = torch.device(options.device)
    stack = stack_of(options, width, precision, compiled)
    for slot in range(width):
        fill(stack, slot, slot)
        stack.owe(slot, 10**6)
    started = time.perf_counter()
    stack.advance(2)
    wait(device)
    preparation = time.perf_counter() - started
    count, started = 0, time.perf_counter()
    while time.perf_counter() - started < options.seconds:
        stack.advance(options.chunk)
        wait(device)
        count += options.chunk
    milliseconds = 1000 * (time.perf_counter() - started) / count
    return {
        "width": width,
        "precision": precision,
        "compiled": compiled,
        "preparation_s": round(preparation, 1),
        "update_ms": round(milliseconds, 3),
        "bound_steps_s": round(width * 10_000 / milliseconds),
        "losses": stack.figures(0),
    }


def independent(options: argparse.Namespace, width: int, precision: str, compiled: bool) -> bool:
    """Returns True if 50 updates give the same bits alone and with neighbours that come and go."""
    results = []
    for neighbours in (False, True):
        stack = stack_of(options, width, precision, compiled)
        fill(stack, 1, 7)
        for piece in range(5):
            if neighbours:
                slot = (2 + piece) % width
                if slot != 1:
                    fill(stack, slot, 100 + piece)
                    stack.owe(slot, 7)
            stack.owe(1, 10)
            stack.advance(10)
        results.append(stack.networks(1))
    return all(np.array_equal(one, other) for one, other in zip(*results, strict=True))


def table(rows: list[dict[str, Any]]) -> str:
    """Returns the measurements as a table."""
    names = "width", "precision", "compiled", "update_ms", "bound_steps_s", "independent"
    lines = [f"| {' | '.join(names)} |", f"|{' --- |' * len(names)}"]
    return "\n".join(
        [*lines, *(f"| {' | '.join(str(row.get(name, '')) for name in names)} |" for row in rows)]
    )


def variants(options: argparse.Namespace) -> Iterator[tuple[int, str, bool]]:
    """Yields width, precision, and whether updates are compiled."""
    widths = [int(width) for width in options.widths.split(",")]
    compiled = [bool(int(flag)) for flag in options.compiled.split(",")]
    for flag, precision, width in product(compiled, options.precisions.split(","), widths):
        yield width, precision, flag


def main() -> int:
    """Measures, prints and writes."""
    parser = argparse.ArgumentParser(
        description=str(__doc__), formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--widths", default="4")
    parser.add_argument("--precisions", default="highest")
    parser.add_argument("--compiled", default="0", help="0, 1 or 0,1")
    parser.add_argument("--mode", default="", help="of torch's compiler")
    parser.add_argument("--seconds", type=float, default=2.0, help="of measurement for each variant")
    parser.add_argument("--chunk", type=int, default=8, help="updates between two looks at the clock")
    parser.add_argument("--output", default="", help="file for the JSON")
    options = parser.parse_args()
    rows = []
    for variant in variants(options):
        try:
            row = speed(options, *variant)
            row["independent"] = independent(options, *variant)
        except Exception as error:
            row = dict(zip(("width", "precision", "compiled"), variant, strict=True)) | {
                "error": f"{type(error).__name__}: {error}"[:1500]
            }
        print(row, flush=True)
        rows.append(row)
    print(table(rows))
    if options.output:
        Path(options.output).write_text(json.dumps(rows, indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

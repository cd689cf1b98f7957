"""Safety of `matmul_precision="medium"`: PPO trained with it, against as many seeds trained without.

    python benchmarks/precision.py --seeds 8 --steps 1M --results build/precision

"medium" lets torch round the operands of float32 products to bfloat16, which it does on processors with AMX.
On any other machine this script does the same rounding: operands to bfloat16, sums in float32. Prints the
difference in mean return and in mastered share at the last evaluation that all seeds have, with Welch's and a
bootstrap 95 % interval.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import torch
from campaigns import main
from scipy import stats
from torch.utils._python_dispatch import TorchDispatchMode

from analysis.statistics import welch
from tma_ray.campaign import Campaign
from tma_ray.results import Results, Table
from tma_ray.runs import Cell, Schedule
from tma_ray.students.ppo.student import PPO
from tma_ray.tasks import MASTERY_RETURN

PRODUCTS = (torch.ops.aten.mm, torch.ops.aten.addmm)
"""Operators of all products of an update, whose last two operands are the matrices."""


class RoundedProducts(TorchDispatchMode):  # type: ignore[no-untyped-call]  # torch has no types there
    """Rounds both operands of every matrix product to bfloat16, in forward and backward passes.

    A mode of torch's functions, above autograd, would miss the backward passes.
    """

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        """Calls the operator `func`, a product with rounded operands."""
        del types
        if func.overloadpacket in PRODUCTS:
            *others, left, right = args
            args = (*others, *(operand.bfloat16().float() for operand in (left, right)))
        return func(*args, **(kwargs or {}))


class RoundedPPO(PPO):
    """PPO whose updates round as "medium" does on a processor with AMX."""

    def _train(self) -> None:
        with RoundedProducts():  # type: ignore[no-untyped-call]
            super()._train()


def medium() -> Cell:
    """Returns the cell with rounded products, by torch if it does so on this machine."""
    if torch.cpu._is_amx_tile_supported():
        return Cell(challenge="easy", student="ppo", student_hyperparameters={"matmul_precision": "medium"})
    return Cell(challenge="easy", student="precision:RoundedPPO")


CAMPAIGN = Campaign(
    name="precision",
    cells=(Cell(challenge="easy", student="ppo"), medium()),
    seeds=tuple(range(8)),
    schedule=Schedule(steps=1_000_000),
)


def compare(root: str) -> None:
    """Prints both samples and the differences of their means."""
    results = Results.open(root)
    rows = results.table(Table.EVALUATIONS).to_pandas()
    cells = results.table(Table.CELLS).to_pandas()[["run_id", "student", "seed", "experiment"]]
    cells["medium"] = cells.run_id.isin(medium_runs(results))
    rows["mastered"] = 100.0 * (rows.episodic_return > MASTERY_RETURN)
    step = rows.groupby("run_id", observed=True).step.max().min()
    means = rows[rows.step == step].groupby("run_id", observed=True)[["episodic_return", "mastered"]].mean()
    joined = cells.drop_duplicates("run_id").set_index("run_id").join(means).sort_values(["medium", "seed"])
    print(joined[["medium", "seed", "episodic_return", "mastered"]].round(1).to_string(index=False))
    for measure in ("episodic_return", "mastered"):
        samples = [joined[joined.medium == flag][measure] for flag in (True, False)]
        print(f"{measure} at {step:,} steps, medium - highest: {difference(*samples)}")


def medium_runs(results: Results) -> set[str]:
    """Returns the ids of the runs with rounded products."""
    runs = results.table(Table.RUNS).to_pandas()
    rounded = runs.spec.str.contains("RoundedPPO") | runs.spec.str.contains('"medium"')
    return set(runs.run_id[rounded])


def difference(sample: pd.Series, reference: pd.Series) -> str:
    """Returns the difference of two means with its confidence intervals, as text."""
    test = welch(sample, reference)
    bootstrap = stats.bootstrap(
        (sample.to_numpy(), reference.to_numpy()),
        lambda one, other, axis: np.mean(one, axis=axis) - np.mean(other, axis=axis),
        n_resamples=10_000,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return (
        f"{test.difference:+.1f}, Welch [{test.low:+.1f}, {test.high:+.1f}] (p = {test.p:.2f}), "
        f"bootstrap [{bootstrap.low:+.1f}, {bootstrap.high:+.1f}], n = {len(sample)} and {len(reference)}"
    )


if __name__ == "__main__":
    raise SystemExit(main(CAMPAIGN, str(__doc__), compare))

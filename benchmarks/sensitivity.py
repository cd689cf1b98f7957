"""Sensitivity of PPO to body, update and rollout length, under Random on the original space, without Ray.

    python benchmarks/sensitivity.py --device cuda --cohort 24 --processes 24 --results build/sensitivity
    python benchmarks/sensitivity.py --parts stock --processes 2 --results build/sensitivity

Part "cohort": PPO with classic and old classic bipedal, and with 20,000 steps an update; part "stock": PPO
updated by stable-baselines3 itself, which learns alone. 1 million steps each. Prints mastered shares and
differences.
"""

from __future__ import annotations

import pandas as pd
from pools import execute, parser
from sac_learning import curves

from analysis.statistics import welch
from tma_ray.campaign.plan import CampaignSpec, Plan, joined_plan
from tma_ray.runs import Cell, Schedule

PARTS: dict[str, tuple[Cell, ...]] = {
    "cohort": (
        Cell(student="ppo"),
        Cell(student="ppo", embodiment="old_classic_bipedal"),
        Cell(student="ppo:steps_per_update=20000"),
    ),
    "stock": (Cell(student="stock:ppo"),),
}
"""Cells by part; the first cell is compared with all others."""


def plan(parts: tuple[str, ...], seeds: int) -> Plan:
    """Return the plan of `parts`, with the first `seeds` of every cell."""
    cells = tuple(cell for part in parts for cell in PARTS[part])
    schedule = Schedule(1_000_000, 250_000, 250_000, training_window=100_000)
    return joined_plan("sensitivity", [CampaignSpec("sensitivity", cells, tuple(range(seeds)), schedule)])


def differences(table: pd.DataFrame) -> str:
    """Return text on means at the last step, and differences from the first cell with intervals."""
    last = table[table.step == table.step.max()]
    cells = {name: cell.mastered for name, cell in last.groupby(["embodiment", "student"], observed=True)}
    first = cells.get(("classic_bipedal", "ppo"))
    lines = []
    for name, cell in cells.items():
        line = (
            f"{' '.join(name)}: {cell.mean():.1f} % mastered, {len(cell)} seeds, deviation {cell.std():.1f}"
        )
        if first is not None and cell is not first and min(len(cell), len(first)) > 1:
            test = welch(cell, first)
            line += f"; {test.difference:+.1f} [{test.low:+.1f}, {test.high:+.1f}] from the first"
        lines.append(line)
    return "\n".join(lines)


def main() -> int:
    """Execute missing runs, and print the differences."""
    options = parser(str(__doc__))
    options.add_argument("--parts", default="cohort,stock", help="cohort, stock or both")
    options.add_argument("--seeds", type=int, default=8, help="of every cell")
    given = options.parse_args()
    execute(plan(tuple(given.parts.split(",")), given.seeds), given)
    print(differences(curves(given.results)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

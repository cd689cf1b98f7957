"""Correlation of runs with the same seed, and the benefit of pairing them in tests, without Ray.

    python benchmarks/pairing.py --processes 2 --results build/pairing
    python benchmarks/pairing.py --csv benchmarks/measured/pairing.csv benchmarks/measured/sensitivity.csv
    python benchmarks/pairing.py --baselines lite-1 simulated-1

Trains PPO under three teachers on the shuffled space, 40 thousand steps each. On this challenge, runs with
the same seed share most: the worlds of evaluations, and the shuffle. Prints the correlation of runs with the
same seed, the widths of Welch's and paired intervals, and the decision of the rule, as rows of
``measured/pairing_of_*.csv``.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import pandas as pd
from pools import execute, parser
from sac_learning import curves
from seed_statistics import least_correlation, pairing_helps, seed_correlation

import analysis
from analysis.statistics import paired, welch
from tma_ray.campaign.plan import CampaignSpec, Plan, joined_plan
from tma_ray.runs import Cell, Schedule

TEACHERS = ("random", "riac", "alp_gmm")

MEASURES = ("mastered", "episodic_return")

CELL = ["embodiment", "teacher", "student"]
"""Columns that distinguish runs with the same seed."""


def plan(seeds: int) -> Plan:
    """Return a plan with the first `seeds` of all teachers."""
    cells = tuple(Cell(challenge="rugged_difficulty", teacher=name, student="ppo") for name in TEACHERS)
    schedule = Schedule(40_000, 40_000, 40_000, training_window=20_000)
    return joined_plan("pairing", [CampaignSpec("pairing", cells, tuple(range(seeds)), schedule)])


def told(name: str, table: pd.DataFrame) -> list[str]:
    """Return the effect of pairing at the ends of runs as CSV lines, by measure and challenge.

    Args:
        name: name of the results.
        table: challenge, `CELL`, seed, step and `MEASURES` of every evaluation.
    """
    last = table[table["step"] == table["step"].max()]
    lines = []
    for challenge, rows in last.groupby("challenge", observed=True):
        for measure in MEASURES:
            wide = rows.pivot(index="seed", columns=CELL, values=measure).dropna()
            wide = wide.loc[:, wide.std() > 0]
            if min(wide.shape) < 2:
                continue
            found, n = seed_correlation([wide.to_numpy(float)]), len(wide)
            widths = [_widths(wide[first], wide[second]) for first, second in itertools.combinations(wide, 2)]
            unpaired, pairs = (sum(each) / len(widths) for each in zip(*widths, strict=True))
            lines.append(
                f"{name},{challenge},{measure},{wide.shape[1]},{n},"
                f'"{found.value:+.2f} [{found.low:+.2f}, {found.high:+.2f}]",{least_correlation(n):.2f},'
                f"{unpaired:.1f},{pairs:.1f},{'paired' if pairing_helps(found, n) else 'not paired'}"
            )
    return lines


def released(name: str) -> pd.DataFrame:
    """Return the evaluations of a release or results root in the format of `told`."""
    frames = analysis.load(name)
    runs = frames.cells.drop_duplicates("run_id")[["run_id", "challenge", *CELL, "expert_knowledge", "seed"]]
    runs = runs.astype(dict.fromkeys(("challenge", *CELL, "expert_knowledge"), str))
    runs["teacher"] += " " + runs["expert_knowledge"]
    means = frames.evaluations.groupby(["run_id", "step"], observed=True)[["episodic_return", "mastered"]]
    table = means.mean().reset_index().merge(runs, on="run_id")
    return table.assign(mastered=100 * table["mastered"])


def _widths(first: pd.Series, second: pd.Series) -> tuple[float, float]:
    """Return the widths of Welch's interval and of the paired interval."""
    apart = welch(first.add_prefix("first"), second.add_prefix("second"))
    pairs = paired(first, second)
    return apart.high - apart.low, pairs.high - pairs.low


def main() -> int:
    """Execute missing runs, or read tables; print the effect of pairing."""
    options = parser(str(__doc__))
    options.add_argument("--seeds", type=int, default=6, help="of every cell")
    options.add_argument("--baselines", nargs="+", default=(), help="releases or roots, to read instead")
    options.add_argument("--csv", nargs="+", default=(), type=Path, help="measured evaluations, likewise")
    reads = {"--csv", "--baselines"} & set(sys.argv)
    given = options.parse_args([*sys.argv[1:], *(["--results", ""] if reads else [])])
    tables = [(file.stem, pd.read_csv(file)) for file in given.csv]
    tables += [(name, released(name)) for name in given.baselines]
    for name, table in tables:
        print(*told(name, table), sep="\n")
    if reads:
        return 0
    execute(plan(given.seeds), given)
    table = curves(given.results)
    table.round(2).to_csv(Path(given.results, "pairing.csv"), index=False)
    print(*told("pairing", table), sep="\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

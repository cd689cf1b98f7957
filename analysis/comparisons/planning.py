"""Plans of experiments: differences that a plan can detect, and runs that a comparison with Random needs."""

import math
from collections.abc import Collection, Hashable, Mapping, Sequence
from functools import cache
from statistics import median
from typing import Any

import pandas as pd

from analysis.baselines.catalogue import find_baseline
from analysis.comparisons.frame import TEST, over_challenges
from analysis.data.reference import BASELINE
from analysis.formatting import number
from analysis.measures.pooling import pooled, runs_after
from analysis.measures.tested import HEADLINE
from analysis.names import label
from analysis.statistics import SIGNIFICANCE, Comparison, Description, Method
from analysis.statistics.power import MOST_SEEDS, POWER, detectable_difference, seeds_needed
from tma_ray.benchmark import paper_results

PAPER, LITE = "paper", ("lite-1", "lite-2")
"""Results that deviations are taken of: the paper's last evaluations, and areas at a tenth of its budget, of
the release with a student of the plan, else of the first."""

FLOOR = 5.0
"""Mastered tasks of the best teacher, in %, under which deviations of a challenge are not used: seeds that
master nothing have no spread."""

LITE_BUDGET = 6_000_000
"""Steps up to which a budget is nearer, as a ratio, to the 2 million of `LITE` than to the paper's 20."""


def detectable_differences(
    cell_rows: Sequence[Mapping[str, Any]], budgets: Mapping[str, int]
) -> pd.DataFrame:
    """Return the smallest differences between two teachers that a plan's seeds can detect, by challenge.

    Args:
        cell_rows: rows of a plan's table of cells: environment, challenge, teacher, expert_knowledge,
            student.
        budgets: largest budget of its runs by environment, in environment steps.

    Returns:
        environment, challenge, seeds (of the teacher and level with the fewest, over all bodies and
        students), and the smallest difference of mastered tasks, in points, that Welch's test at 0.05
        finds in 80 of 100 repetitions between two teachers of the smallest, the median and the largest
        standard deviation among the results named in spread_of: up to `LITE_BUDGET` steps those of the
        headline in one of `LITE`, if a teacher masters `FLOOR` % of the challenge there, else of the last
        evaluation in the paper's tables; NaN for a challenge that neither has, or a single seed.
    """
    used = ["environment", "challenge", "teacher", "expert_knowledge", "student"]
    rows = pd.DataFrame(list(cell_rows), columns=used)
    found = []
    for (environment, challenge), mine in rows.groupby(["environment", "challenge"], sort=False):
        seeds = int(mine.groupby(["teacher", "expert_knowledge"]).size().min())
        name = next((each for each in LITE if set(mine["student"]) & _lite_students(each)), LITE[0])
        lite = _lite_deviations(name) if budgets[str(environment)] <= LITE_BUDGET else {}
        spread = lite.get((environment, challenge), [])
        if not spread:
            results = [r for r in paper_results() if (r.environment, r.challenge) == (environment, challenge)]
            whole, levels = max((each.seeds for each in results), default=0), set(mine["expert_knowledge"])
            whole_pools = (r for r in results if r.seeds == whole and r.expert_knowledge in levels)
            spread, name = [each.std for each in whole_pools if not each.doubt], PAPER
        marks = (min(spread), median(spread), max(spread)) if spread else (math.nan,) * 3
        samples = [Description(n=seeds, mean=math.nan, std=std) for std in marks]
        gaps = [detectable_difference(sample, sample) for sample in samples]
        found.append([environment, challenge, seeds, *gaps, name])
    columns = ["environment", "challenge", "seeds", "steadiest", "typical", "most_varied", "spread_of"]
    return pd.DataFrame(found, columns=columns)


@cache
def _lite_students(name: str) -> frozenset[str]:
    return frozenset(find_baseline(name).manifest.holds["students"])


@cache
def _lite_deviations(name: str) -> dict[Hashable, list[float]]:
    """Return by environment and challenge a release's standard deviations, of teachers with most seeds.

    Challenges on which no teacher masters `FLOOR` % are missing.
    """
    table = pooled(runs_after(find_baseline(name).frames(), training=False), [HEADLINE])
    place = ["environment", "challenge"]
    whole = table.groupby(place)["n"].transform("max") == table["n"]
    learned = table.groupby(place)[f"{HEADLINE}_mean"].transform("max") >= FLOOR
    groups = table[whole & learned & (table[f"{HEADLINE}_std"] > 0)].groupby(place)[f"{HEADLINE}_std"]
    return {key: stds.tolist() for key, stds in groups}


def plans_against_random(
    runs: pd.DataFrame, teachers: Collection[str], hours: pd.Series, measure: str = HEADLINE
) -> list[str]:
    """Return a sentence on each teacher that does not differ from Random: runs and hours until a test would.

    Args:
        runs: rows of `pooling.pool_runs`.
        teachers: names of the teachers in question.
        hours: wall-clock hours of each run, by run id.
        measure: column of `runs`, in per cent.
    """
    table = over_challenges(runs, measure, BASELINE) if len(runs) else pd.DataFrame()
    said = []
    for row in table.to_dict("records"):
        if row["first"] not in teachers or row["reason"] or row["holm"] < SIGNIFICANCE:
            continue
        test, challenges = Comparison(**{name: row[name] for name in TEST}), row["challenges"]
        each = 2 / (1 / test.n + 1 / test.reference_n)
        count = seeds_needed(test, each if test.method == Method.PAIRED else each / challenges)
        name, points = label(str(row["first"])), number(abs(test.difference))
        where = f"each of the {challenges} challenges" if challenges > 1 else "the challenge"
        if count is None:
            said.append(
                f"The difference of {points} points between {name} and Random is too small, or rests on too "
                f"few runs, to say how many runs would find it: over {MOST_SEEDS} on {where}, if any number."
            )
            continue
        spent = runs["run_id"].map(hours).groupby(runs["teacher"]).median()
        total = count * challenges * float(spent[row["first"]] + spent[BASELINE])
        words = f", about {number(total, 0 if total >= 10 else 1)} hours of runs,"
        said.append(
            f"If the true difference between {name} and Random is the {points} points seen here, a new "
            f"experiment with {count} runs of either on {where}{words if math.isfinite(total) else ''} finds "
            f"it with probability {POWER} (p < {SIGNIFICANCE}, the two alone). Fix that number before the "
            f"first run and test once, after the last: adding runs until a difference is significant finds "
            f"differences that are not there."
        )
    return said

"""Power analysis of experiments: detectable differences, and runs needed to detect those from Random."""

import math
from collections.abc import Collection, Hashable, Mapping, Sequence
from functools import cache
from statistics import median
from typing import Any

import pandas as pd

from analysis.baselines.catalogue import find_baseline
from analysis.comparisons.pairwise import TEST, over_challenges
from analysis.data.reference import BASELINE
from analysis.formatting import number
from analysis.measures.pooling import pooled, runs_after
from analysis.measures.tested import HEADLINE
from analysis.names import label
from analysis.statistics import SIGNIFICANCE, Comparison, Description, Method
from analysis.statistics.power import MOST_SEEDS, POWER, detectable_difference, seeds_needed
from tma_ray.benchmark import paper_results

PAPER, LITE = "paper", ("lite-1", "lite-2")
"""Sources of standard deviations: the paper's last evaluations, or the headline measure in the first of
these releases that has a student of the plan."""

FLOOR = 5.0  # deviations are unusable on challenges where the best teacher masters a smaller percentage

LITE_BUDGET = 6_000_000
"""Largest budget, in steps, that is closer (as a ratio) to the 2 million steps of `LITE` than to the paper's
20 million."""


def detectable_differences(
    cell_rows: Sequence[Mapping[str, Any]], budgets: Mapping[str, int]
) -> pd.DataFrame:
    """Return the smallest difference between two teachers that a plan can detect on each challenge.

    Args:
        cell_rows: environment, challenge, teacher, expert_knowledge and student of each cell of a plan.
        budgets: largest budget of its runs by environment, in environment steps.

    Returns:
        environment, challenge, seeds (smallest number of a teacher and level), and the smallest difference of
        mastered tasks, in points, that Welch's test at 0.05 finds with power 0.8 between two teachers of the
        smallest, the median and the largest standard deviation of the source spread_of. That is one of `LITE`
        for up to `LITE_BUDGET` steps, if a teacher masters `FLOOR` % of the challenge there, else the paper's
        tables. NaN without a source, or for a single seed.
    """
    used = ["environment", "challenge", "teacher", "expert_knowledge", "student"]
    rows = pd.DataFrame(list(cell_rows), columns=used)
    found = []
    for (environment, challenge), cells in rows.groupby(["environment", "challenge"], sort=False):
        seeds = int(cells.groupby(["teacher", "expert_knowledge"]).size().min())
        name = next((name for name in LITE if set(cells["student"]) & _lite_students(name)), LITE[0])
        lite = _lite_deviations(name) if budgets[str(environment)] <= LITE_BUDGET else {}
        spread = lite.get((environment, challenge), [])
        if not spread:
            results = [r for r in paper_results() if (r.environment, r.challenge) == (environment, challenge)]
            whole, levels = max((r.seeds for r in results), default=0), set(cells["expert_knowledge"])
            whole_pools = (r for r in results if r.seeds == whole and r.expert_knowledge in levels)
            spread, name = [r.std for r in whole_pools if not r.doubt], PAPER
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
    """Return, by challenge, the standard deviations of the release's teachers with the most seeds.

    Challenges on which no teacher masters `FLOOR` % are missing.
    """
    table = pooled(runs_after(find_baseline(name).frames(), training=False), [HEADLINE])
    key = ["environment", "challenge"]
    whole = table.groupby(key)["n"].transform("max") == table["n"]
    learned = table.groupby(key)[f"{HEADLINE}_mean"].transform("max") >= FLOOR
    groups = table[whole & learned & (table[f"{HEADLINE}_std"] > 0)].groupby(key)[f"{HEADLINE}_std"]
    return {challenge: stds.tolist() for challenge, stds in groups}


def plans_against_random(
    runs: pd.DataFrame, teachers: Collection[str], hours: pd.Series, measure: str = HEADLINE
) -> list[str]:
    """Return sentences about the runs and hours it would take to decide comparisons with Random.

    Args:
        runs: rows from `pooling.pool_runs`.
        teachers: names of the teachers.
        hours: wall-clock hours of each run, by run id.
        measure: column of `runs`, in per cent.
    """
    table = over_challenges(runs, measure, BASELINE) if len(runs) else pd.DataFrame()
    sentences = []
    for row in table.to_dict("records"):
        if row["first"] not in teachers or row["reason"] or row["holm"] < SIGNIFICANCE:
            continue
        test, challenges = Comparison(**{name: row[name] for name in TEST}), row["challenges"]
        runs_each = 2 / (1 / test.n + 1 / test.reference_n)
        count = seeds_needed(test, runs_each if test.method == Method.PAIRED else runs_each / challenges)
        name, points = label(str(row["first"])), number(abs(test.difference))
        where = f"each of the {challenges} challenges" if challenges > 1 else "the challenge"
        if count is None:
            sentences.append(
                f"The difference of {points} points between {name} and Random is too small, or rests on too "
                f"few runs, to say how many runs would find it: over {MOST_SEEDS} on {where}, if any number."
            )
            continue
        spent = runs["run_id"].map(hours).groupby(runs["teacher"]).median()
        total = count * challenges * float(spent[row["first"]] + spent[BASELINE])
        words = f", about {number(total, 0 if total >= 10 else 1)} hours of runs,"
        sentences.append(
            f"If the true difference between {name} and Random is the {points} points seen here, a new "
            f"experiment with {count} runs of either on {where}{words if math.isfinite(total) else ''} finds "
            f"it with probability {POWER} (p < {SIGNIFICANCE}, the two alone). Fix that number before the "
            f"first run and test once, after the last: adding runs until a difference is significant finds "
            f"differences that are not there."
        )
    return sentences

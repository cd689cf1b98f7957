"""Results of the long runs, and what they say about the predictions of docs/long_runs.md.

    python benchmarks/long_runs.py

Writes six tables to benchmarks/measured: the runs that are done, mastered tasks at each budget, decided
pairs of teachers, agreement of the early budget with later ones, the orders so far, and predictions.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import pandas as pd
from lite import plan

import analysis
from analysis.comparisons.budgets import BUDGETS, BudgetAgreement, agreements, by_run
from analysis.comparisons.pairwise import corrected, pairwise
from analysis.comparisons.ranks import Rank, ranks
from analysis.data.columns import STRATA
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE
from analysis.formatting import interval_text, number, steps_text
from analysis.measures.pooling import result_runs
from analysis.measures.run_measures import evaluations_at
from analysis.measures.tested import AXES, FINAL, HEADLINE
from analysis.names import label, teacher_order
from analysis.statistics.samples import Standing, greater
from tma_ray.benchmark import find_experiment

MEASURED = Path(__file__).parent / "measured"

EXPERIMENT, STAGES = find_experiment("long_1"), ("parkour", "stump_tracks")
"""Stages that the release needs."""

EARLY, LAST = BUDGETS[0], BUDGETS[-1]

MOST = 0.84
"""Agreement of area at 2 million and last three at 5 million steps in the first pilot."""

HALF = 5
"""Worst rank of the better half of ten teachers."""

BETTER = ("alp_gmm", "riac", "covar_gmm")
"""Teachers that are better than Random in Parkour according to the paper."""

NEGLIGIBLE = 1.0
"""Percentage of tasks under which a climber masters practically none."""

Key: TypeAlias = tuple[str, str, str]
"""Environment, challenge and body of a space."""

SPACES: Mapping[str, Key] = {
    "Parkour, walker": ("parkour", "original", "classic_bipedal"),
    "Parkour, fish": ("parkour", "original", "fish"),
    "Stump Tracks, original": ("stump_tracks", "original", "classic_bipedal"),
    "Stump Tracks, mostly unfeasible": ("stump_tracks", "mostly_unfeasible", "classic_bipedal"),
    "Parkour, climber": ("parkour", "original", "climbing_chimpanzee"),
}

WALKER, FISH, ORIGINAL, UNFEASIBLE, CLIMBER = SPACES
COMPARED = WALKER, FISH, ORIGINAL, UNFEASIBLE

SETS: Mapping[str, Sequence[str]] = {
    "all four": COMPARED,
    "Parkour, both bodies": COMPARED[:2],
    "Stump Tracks, both challenges": COMPARED[2:],
}
"""Sets of spaces over which teachers are compared."""

Runs: TypeAlias = Mapping[int, pd.DataFrame]
"""Rows of `pooling.pool_runs` by the budget at which they are measured, in steps."""


class Verdict(NamedTuple):
    """Standing of a prediction, and the numbers that decide it."""

    standing: Standing
    evidence: str


class Prediction(NamedTuple):
    """Prediction of the page.

    Attributes:
        number: its number there.
        spaces: spaces whose runs must all be done.
        judge: function that applies its rule.
    """

    number: int
    spaces: Sequence[str]
    judge: Callable[[Runs], Verdict]


def of_space(runs: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return the runs of a space."""
    environment, challenge, body = SPACES[name]
    mask = (runs["environment"] == environment) & (runs["challenge"] == challenge)
    return runs[mask & (runs["embodiment"] == body)]


def over_spaces(runs: Runs, spaces: Sequence[str]) -> dict[tuple[str, int], BudgetAgreement]:
    """Return the agreements of the early budget by measure and later budget, over spaces of equal weight."""
    table = by_run(pd.concat(of_space(rows, name) for rows in runs.values() for name in spaces))
    means = table.groupby([*STRATA, "teacher"]).mean().groupby("teacher").mean()
    return {(found.measure, found.budget): found for found in agreements(table, means)}


def agrees_at_most(runs: Runs, budget: int) -> Verdict:
    """Judge whether the order at the early budget agrees with a later one by `MOST` or less."""
    found = over_spaces(runs, COMPARED)[FINAL, budget]
    low, high = found.correlation.low, found.correlation.high
    standing = Standing.SUPPORTED if high <= MOST else Standing.UNDECIDED
    return Verdict(Standing.REFUTED if low > MOST else standing, f"correlation {found}")


def rank_of_random(runs: Runs, space: str, budget: int) -> Rank:
    """Return the rank of Random in a space by the last three evaluations."""
    (rank,) = (
        rank for rank in ranks(of_space(runs[budget], space), measure=FINAL) if rank.teacher == BASELINE
    )
    return rank


def in_the_better_half(runs: Runs, budgets: Sequence[int]) -> Verdict:
    """Judge whether Random is in the better half on the original space, at all of several budgets."""
    found = {budget: rank_of_random(runs, ORIGINAL, budget) for budget in budgets}
    standing = Standing.UNDECIDED
    if all(rank.worst <= HALF for rank in found.values()):
        standing = Standing.SUPPORTED
    elif any(rank.best > HALF for rank in found.values()):
        standing = Standing.REFUTED
    return Verdict(standing, "; ".join(f"{_rank(rank)} at {steps_text(at)}" for at, rank in found.items()))


def in_the_worse_half(runs: Runs) -> Verdict:
    """Judge whether Random is in the worse half on the mostly unfeasible space in the end."""
    rank = rank_of_random(runs, UNFEASIBLE, LAST)
    standing = Standing.SUPPORTED if rank.best > HALF else Standing.UNDECIDED
    return Verdict(Standing.REFUTED if rank.worst <= HALF else standing, _rank(rank))


def _rank(rank: Rank) -> str:
    return f"rank {rank.rank} [{rank.best}, {rank.worst}] of {rank.of}"


def better_than_random(runs: Runs, space: str) -> Verdict:
    """Judge whether the teachers of `BETTER` are better than Random with a body, of six tests on two."""
    tests = pd.concat(
        pairwise(of_space(runs[LAST], name), FINAL, BASELINE, detectable=False).assign(space=name)
        for name in (FISH, WALKER)
    )
    tests = corrected(tests[tests["first"].isin(BETTER)].reset_index(drop=True), [])
    tests = tests[tests["space"] == space].set_index("first").loc[list(BETTER)]
    ends = tests[["simultaneous_low", "simultaneous_high"]].itertuples(index=False, name=None)
    standings = {teacher: greater(*pair) for teacher, pair in zip(tests.index, ends, strict=True)}
    standing = Standing.UNDECIDED
    if set(standings.values()) == {Standing.SUPPORTED}:
        standing = Standing.SUPPORTED
    elif Standing.REFUTED in standings.values():
        standing = Standing.REFUTED
    evidence = (
        f"{label(teacher)} {number(test['difference'])} "
        f"{interval_text(test['simultaneous_low'], test['simultaneous_high'])}"
        for teacher, test in tests.iterrows()
    )
    return Verdict(standing, ", ".join(evidence))


def climbs_nowhere(runs: Runs) -> Verdict:
    """Judge whether the climber masters less than `NEGLIGIBLE` in every run."""
    mastered = of_space(runs[LAST], CLIMBER)[FINAL]
    standing = Standing.SUPPORTED if (mastered < NEGLIGIBLE).all() else Standing.REFUTED
    return Verdict(standing, f"{number(mastered.max(), 2)} % at most in {len(mastered)} runs")


PREDICTIONS = (
    *(
        Prediction(place, COMPARED, lambda runs, budget=budget: agrees_at_most(runs, budget))  # type: ignore[misc]
        for place, budget in enumerate(BUDGETS[1:], start=1)
    ),
    Prediction(4, [ORIGINAL], lambda runs: in_the_better_half(runs, BUDGETS[2:])),
    Prediction(5, [UNFEASIBLE], in_the_worse_half),
    Prediction(6, [FISH, WALKER], lambda runs: better_than_random(runs, FISH)),
    Prediction(7, [FISH, WALKER], lambda runs: better_than_random(runs, WALKER)),
    Prediction(8, [CLIMBER], climbs_nowhere),
)


def planned() -> pd.DataFrame:
    """Return run_id, environment, challenge and embodiment of the runs that the release needs."""
    return pd.DataFrame(
        [
            (run.run_id, run.environment, run.challenge, run.embodiment)
            for stage in STAGES
            for run in plan(EXPERIMENT, stage).runs
        ],
        columns=["run_id", "environment", "challenge", "embodiment"],
    )


def done(needed: pd.DataFrame, finished: Collection[str]) -> pd.DataFrame:
    """Return the number of runs that are done and needed, by space.

    Args:
        needed: runs from `planned`.
        finished: ids of the runs that are done.
    """
    counts = {}
    for name in SPACES:
        run_ids = of_space(needed, name)["run_id"]
        counts[name] = int(run_ids.isin(list(finished)).sum()), len(run_ids)
    return pd.DataFrame(counts, index=["done", "needed"]).T


def lacking(counts: pd.DataFrame, spaces: Sequence[str]) -> str:
    """Return the reason why spaces are not judged, or an empty string if all of their runs are done.

    Args:
        counts: result of `done`.
        spaces: names of the spaces.
    """
    have, need = counts.loc[list(spaces)].sum()
    return f"{have} of {need} runs are done" if have < need else ""


def predictions(runs: Runs, counts: pd.DataFrame) -> pd.DataFrame:
    """Return the standing of each prediction; those that lack runs have no data."""
    rows = []
    for prediction in PREDICTIONS:
        reason = lacking(counts, prediction.spaces)
        verdict = Verdict(Standing.NO_DATA, reason) if reason else prediction.judge(runs)
        rows.append((prediction.number, str(verdict.standing), verdict.evidence))
    return pd.DataFrame(rows, columns=["prediction", "standing", "evidence"])


ORDER: Mapping[str, Callable[[BudgetAgreement], str]] = {
    "tau": lambda found: number(found.tau, 2),
    "pairs that change places": lambda found: f"{found.reversed_pairs} of {found.pairs}",
}
"""Texts that compare the orders of two means, by name."""


def at_later_budgets(
    runs: Runs, sets: Iterable[str], texts: Mapping[str, Callable[[BudgetAgreement], str]]
) -> pd.DataFrame:
    """Return texts on the agreement of `HEADLINE` at the early budget with both measures at later ones.

    Args:
        runs: runs at each budget.
        sets: names of sets of spaces, each with a row for every later budget.
        texts: functions that describe an agreement, by name.
    """
    rows = []
    for name in sets:
        found = over_spaces(runs, SETS[name])
        for budget in BUDGETS[1:]:
            later = [found[measure, budget] for measure in (FINAL, HEADLINE)]
            rows.append(
                [name, steps_text(budget), *(text(each) for each in later for text in texts.values())]
            )
    heads = [f"{words}, {name}" for words in ("last three", "area") for name in texts]
    return pd.DataFrame(rows, columns=["spaces", "later budget", *heads])


def agreement(runs: Runs, counts: pd.DataFrame) -> pd.DataFrame:
    """Return the correlations and orders of sets of spaces whose runs are all done."""
    complete = [name for name, spaces in SETS.items() if not lacking(counts, spaces)]
    return at_later_budgets(runs, complete, {"correlation": str, **ORDER})


def orders(runs: Runs, counts: pd.DataFrame) -> pd.DataFrame:
    """Return the orders of the means so far, for sets that lack runs but have one of each teacher."""
    fewest = {}
    for name, spaces in SETS.items():
        seeds = [of_space(runs[LAST], space).groupby("teacher").size() for space in spaces]
        fewest[name] = min(int(each.reindex(EXPERIMENT.teachers, fill_value=0).min()) for each in seeds)
    begun = [name for name, spaces in SETS.items() if fewest[name] and lacking(counts, spaces)]
    table = at_later_budgets(runs, begun, ORDER)
    table.insert(1, "fewest seeds", table["spaces"].map(fewest))
    return table


def decided(runs: Runs, counts: pd.DataFrame) -> pd.DataFrame:
    """Return the number of decided pairs of teachers at the last budget, by environment and measure.

    Environments that lack runs have no rows.
    """
    rows = []
    for (name, spaces), measure in itertools.product([*SETS.items()][1:], (FINAL, HEADLINE)):
        if not lacking(counts, spaces):
            found = ranks(pd.concat(of_space(runs[LAST], space) for space in spaces), measure=measure)
            pairs = sum(len(rank.better) for rank in found)
            beside = sum(BASELINE in (*rank.better, *rank.worse) for rank in found)
            rows.append((name, AXES[measure], f"{pairs} of 45", f"{beside} of 9"))
    return pd.DataFrame(rows, columns=["spaces", "measure", "pairs", "pairs with Random"])


def mastered(runs: Runs) -> pd.DataFrame:
    """Return the mean area at the early budget and the last three at all, by space and teacher, in %."""
    rows = []
    for name in SPACES:
        at = {budget: of_space(table, name).groupby("teacher") for budget, table in runs.items()}
        for teacher in sorted(at[LAST].groups, key=lambda teacher: teacher_order(str(teacher))):
            group = at[LAST].get_group(teacher)
            values = [at[EARLY].get_group(teacher)[HEADLINE].mean()]
            values += [at[budget].get_group(teacher)[FINAL].mean() for budget in BUDGETS]
            rows.append((name, teacher, len(group), *(number(value) for value in values)))
    budgets = [f"{budget // 10**6} M" for budget in BUDGETS]
    return pd.DataFrame(rows, columns=["space", "teacher", "runs", f"area, {budgets[0]}", *budgets])


def ended(frames: Frames) -> set[str]:
    """Return the ids of the runs that are done."""
    return set(frames.cells.loc[frames.cells["status"] == "done", "run_id"])


def at_budgets(frames: Frames) -> Runs:
    """Return the runs that are done, measured at all of `BUDGETS`."""
    finished = ended(frames)
    values = evaluations_at(frames, BUDGETS)
    values = values[values["run_id"].isin(finished)]
    runs = {budget: result_runs(frames, values[values["step"] == budget]) for budget in BUDGETS}
    return {budget: table[table[FINAL].notna()] for budget, table in runs.items()}


def core_hours(frames: Frames) -> pd.Series:
    """Return the hours of finished runs, each of which has a core of its own, by space."""
    runs, hours = frames.cells.drop_duplicates("run_id"), frames.run_hours
    return pd.Series({name: hours.reindex(of_space(runs, name)["run_id"]).sum() for name in SPACES})


def main() -> int:
    """Write and print the tables."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument(
        "--results", default=str(MEASURED / EXPERIMENT.name), help="root with the finished runs"
    )
    parser.add_argument("--output", type=Path, default=MEASURED, help="folder of the tables")
    options = parser.parse_args()
    frames = analysis.load(options.results)
    runs, counts = at_budgets(frames), done(planned(), ended(frames))
    hours = core_hours(frames).map(number).rename("core-hours")
    progress = counts.join(hours).rename_axis("space").reset_index()
    tables = {
        "done": progress,
        "mastered": mastered(runs),
        "decided": decided(runs, counts),
        "agreement": agreement(runs, counts),
        "orders": orders(runs, counts),
        "predictions": predictions(runs, counts),
    }
    for name, table in tables.items():
        print(table.to_csv(index=False))
        table.to_csv(options.output / f"long_runs_{name}.csv", index=False)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

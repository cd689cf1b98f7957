"""Comparisons in plain words, with their uncertainty, and the ranking on each challenge."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import pandas as pd

from analysis.comparisons.frame import pairwise
from analysis.data.frames import Frames
from analysis.data.reference import NO_BASELINE, is_baseline
from analysis.formatting import amount, ends, listed, number, p_value, plus_minus
from analysis.measures.pooling import (
    COMPARED,
    CONDITIONS,
    POOLED,
    condition_words,
    pooled,
    runs_after,
    varying,
)
from analysis.measures.tested import MEASURE
from analysis.names import challenge_title, label
from analysis.statistics import SIGNIFICANCE, Method

FEW_SEEDS: Final = 10
"""Under this many seeds a sentence warns the reader; the paper used 16 to 48."""


def in_brief(smallest: float) -> str:
    """Returns what a sentence on tests adds of a group with `smallest` runs: ``; few seeds``, or nothing."""
    return "; few seeds" if smallest < FEW_SEEDS else ""


def caveat(smallest: float) -> str:
    """Returns a sentence for readers of results of which one has no more than `smallest` runs, or nothing."""
    if not smallest < FEW_SEEDS:
        return ""
    seeds = f"{smallest:.0f} seed{'s' if smallest > 1 else ''}"
    return (
        f"With no more than {seeds} only large differences can show, and their size is uncertain; "
        f"take this as an indication, not as a result."
    )


class Measure(NamedTuple):
    """How a measure is talked about: its column, unit, unit of differences, and verbs."""

    column: str
    unit: str
    points: str
    leads: str
    has: str


MASTERED = Measure(
    column="mastered_percent",
    unit="\N{NO-BREAK SPACE}%",
    points=" points",
    leads="masters the most test tasks:",
    has="masters",
)
METHODS = {
    Method.WELCH: "Welch's t-test",
    Method.PAIRED: "paired t-test",
    Method.PERMUTATION: "permutation test",
    Method.SIGN_FLIP: "sign-flip test",
}


def verdict(test: pd.Series | Mapping[str, Any]) -> str:
    """Returns the result of a test against Random in a word or two, after Holm, or why there was none."""
    if test["reason"]:
        return str(test["reason"])
    if not test["holm"] < SIGNIFICANCE:
        return "not distinguishable"
    return "better" if test["difference"] > 0 else "worse"


def findings(summary: pd.DataFrame, tests: pd.DataFrame) -> list[str]:
    """Returns the sentences that open a comparison.

    Args:
        summary: rows of `measures.summarise`, of one comparison.
        tests: rows of `measures.against_baseline` for several measures, of the same comparison.
    """
    read = summary[summary["n"] > 0]
    if read.empty:
        return ["No run has been evaluated yet."]
    if (read["mastered_percent_mean"] == 0).all():
        return [
            "Nothing mastered: no seed masters any test task, so teachers are not compared. Their mean "
            "returns do not say which of them would master more."
        ]
    sentences, measure = [], MASTERED
    tests = tests[tests["measure"] == measure.column].set_index("teacher")
    final = read[~read["provisional"]]
    if len(final):
        final = final.sort_values(f"{measure.column}_mean", ascending=False, kind="stable")
        sentences += [_leader(final, measure), *_certainty(final, tests, measure)]
    running = read[read["provisional"]]
    if len(final) == 1:
        sentences.append("No other teacher has finished." if len(running) else "Other teachers were not run.")
    return sentences + [_so_far(row, tests, measure) for _, row in running.iterrows()]


def _leader(ranked: pd.DataFrame, measure: Measure) -> str:
    best = ranked.iloc[0]
    spread = f"mean ± standard deviation over {best['n']} seeds" if best["n"] > 1 else "1 seed"
    verb = measure.leads if len(ranked) > 1 else measure.has
    return f"{label(best['teacher'])} {verb} {_value(best, measure)} ({spread})."


def _value(row: pd.Series, measure: Measure) -> str:
    return plus_minus(row[f"{measure.column}_mean"], row[f"{measure.column}_std"]) + measure.unit


def _so_far(row: pd.Series, tests: pd.DataFrame, measure: Measure) -> str:
    """Returns where a teacher stands whose runs are all under way, beside Random at the same step."""
    name = label(row["teacher"])
    text = f"So far, at {amount(row['step'])} steps, {name} {measure.has} {_value(row, measure)}"
    if row["teacher"] in tests.index and math.isfinite(tests.loc[row["teacher"], "difference"]):
        test = tests.loc[row["teacher"]]
        text += f", {_gap(test['difference'], measure)} than Random at that step"
    return f"{text}; its runs are still under way."


def _gap(difference: float, measure: Measure) -> str:
    return f"{number(abs(difference))}{measure.points} {'more' if difference >= 0 else 'less'}"


def _certainty(ranked: pd.DataFrame, tests: pd.DataFrame, measure: Measure) -> list[str]:
    """Returns how far the order of the finished teachers can be trusted."""
    best = ranked["teacher"].iloc[0]
    if len(ranked) == 1:
        return []
    tests = tests[tests.index.isin(ranked["teacher"])]
    if (tests["reason"] == NO_BASELINE).all():
        return ["Random has not been run to its end here, so no test was made."]
    if is_baseline(best):
        sentences = ["No teacher does better than Random."]
    else:
        sentences = [_against_random(best, tests.loc[best], measure)]
    also = "also " if not is_baseline(best) and tests.loc[best, "holm"] < SIGNIFICANCE else ""
    return [*sentences, *_others(tests.drop(index=best, errors="ignore"), also), *_few(tests)]


def _against_random(teacher: str, test: pd.Series, measure: Measure) -> str:
    lead = f"That is {_gap(test['difference'], measure)} than Random"
    if test["reason"] == "needs 2 seeds":
        return f"{lead}, but a single seed cannot tell skill from luck: nothing can be concluded."
    if test["reason"]:
        return f"{lead}; not tested ({test['reason']})."
    interval = f"95 % confidence interval {ends(test['low'], test['high'])}"
    found = f"{METHODS[Method(test['method'])]}, {p_value(test['holm'])} after Holm"
    if test["holm"] < SIGNIFICANCE:
        return f"{lead} ({interval}), a significant difference ({found})."
    return (
        f"{lead} ({interval}), which may be chance: the seeds do not tell {label(teacher)} and Random apart "
        f"({found})."
    )


def _others(tests: pd.DataFrame, also: str) -> list[str]:
    sentences = []
    verdicts = tests.apply(verdict, axis=1) if len(tests) else pd.Series(dtype=object)
    for word, phrase in (
        ("better", f"{also}significantly better than Random".capitalize().replace("random", "Random")),
        ("worse", "Significantly worse than Random"),
        ("not distinguishable", "Not distinguishable from Random"),
    ):
        teachers = sorted(label(teacher) for teacher in verdicts[verdicts == word].index)
        if teachers:
            sentences.append(f"{phrase}: {listed(teachers)}.")
    return sentences


def _few(tests: pd.DataFrame) -> list[str]:
    tested = tests[tests["reason"] == ""]
    text = caveat(tested[["n", "reference_n"]].min().min())
    return [text] if text else []


TEACHER = ["environment", "expert_knowledge", "teacher", *CONDITIONS]
"""Columns that tell the results of one sentence: a teacher's at one level, of one kind."""


def ranking(frames: Frames, share: float = 1.0, measure: str = MEASURE) -> pd.DataFrame:
    """Returns one row for each result: a teacher at a level on a challenge, pooled as the paper pools.

    Args:
        frames: what was run.
        share: of the budget, after which runs are read.
        measure: of `tested.MEASURES`.

    Returns:
        `pooling.POOLED`, runs, n, missing, mean and standard deviation (as mastered_percent_mean and _std),
        worst (of a single run), rank (1 for the highest mean of a comparison), and of Welch's test against
        Random: reference_n (its runs), difference, low, high, p, reason, and holm: p adjusted for all
        teachers of the comparison. Best first.
    """
    return ranked(runs_after(frames, share, training=False), measure)


def ranked(runs: pd.DataFrame, measure: str = MEASURE) -> pd.DataFrame:
    """Returns the rows of `ranking`, from runs of `student_pools.runs_after`."""
    table = pooled(runs, [measure])
    tests = pairwise(runs, measure, "random", detectable=False).rename(columns={"first": "teacher"})
    columns = ["reference_n", "difference", "low", "high", "p", "holm", "reason"]
    table = table.merge(tests[[*POOLED, *columns]], on=POOLED, how="left")
    table["reason"] = table["reason"].fillna("")
    worst = runs.groupby(POOLED, dropna=False, sort=True)[measure].min()  # in the order of `table`
    table["worst"] = worst.to_numpy()
    means = table.groupby(COMPARED, dropna=False)[f"{measure}_mean"]
    table["rank"] = means.rank(ascending=False, method="min")
    return table.sort_values([*COMPARED, "rank", "teacher"], ignore_index=True)


def sentences(table: pd.DataFrame) -> list[str]:
    """Returns what a `ranking` says of every teacher but Random, in plain words.

    Differences count as found where p is under 0.05 after Holm's correction for all teachers of a challenge.
    """
    said, told = [], varying(table[table["p"].notna()])
    for key, rows in table.groupby(TEACHER, sort=True, dropna=False):
        environment, level, teacher = map(str, key[:3])
        tested = rows[rows["p"].notna()]
        if is_baseline(teacher) or tested.empty:
            continue
        better = int(((tested["holm"] < SIGNIFICANCE) & (tested["difference"] > 0)).sum())
        worse = int(((tested["holm"] < SIGNIFICANCE) & (tested["difference"] < 0)).sum())
        rest = len(tested) - better - worse
        parts = [f"better than Random on {better} of {len(tested)}"]
        parts += [f"worse on {worse}"] if worse else []
        parts += [f"not distinguishable on {rest}"] if rest else []
        few = in_brief(tested[["n", "reference_n"]].min().min())
        where = ", ".join([environment, f"expert knowledge {level}", *condition_words(rows.iloc[0], told)])
        said.append(f"{label(teacher)} ({where}): {', '.join(parts)} (p < {SIGNIFICANCE} after Holm{few}).")
    return said


def places(table: pd.DataFrame) -> list[str]:
    """Returns the challenge of each row, with what sets it apart from others of its name in the table.

    Args:
        table: with the columns `pooling.COMPARED`.
    """
    here = ["environment", "challenge", "expert_knowledge"]
    several = ["pool", "test_sets", *(name for name in CONDITIONS if name != "variant")]
    told = {name: table.groupby(here)[name].transform("nunique", dropna=False) > 1 for name in several}
    found = []
    for position, (_, row) in enumerate(table.iterrows()):
        environment, challenge = row["environment"], row["challenge"]
        title = challenge_title(environment, challenge, f"{environment} {challenge}")
        apart = [name for name in several if told[name].iloc[position]]
        named = [str(row[name]) for name in ("pool", "test_sets") if name in apart and pd.notna(row[name])]
        words = condition_words(row, [name for name in apart if name in CONDITIONS])
        found.append(", ".join([title, *named, *words]))
    return found

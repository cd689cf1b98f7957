"""Sentences about comparisons and their uncertainty, and tables of the ranking on each challenge."""

import math

import numpy as np
import pandas as pd

from analysis.comparisons.pairwise import CORRECTED, TEST, pairwise
from analysis.data import columns
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE, NO_BASELINE, is_baseline
from analysis.formatting import (
    few_seeds_suffix,
    few_seeds_warning,
    interval_text,
    listed,
    number,
    p_value,
    plus_minus,
    steps_text,
)
from analysis.measures import pooling
from analysis.measures.tested import FINAL, HEADLINE, PAPERS, THAN, Verdict, on_both_axes, verdict
from analysis.names import challenge_title, label, title
from analysis.statistics import SIGNIFICANCE, Method
from tma_ray.support.texts import counted

METHODS = {
    Method.WELCH: "Welch's t-test",
    Method.PAIRED: "paired t-test",
    Method.PERMUTATION: "permutation test",
    Method.SIGN_FLIP: "sign-flip test",
}

UNIT = "\N{NO-BREAK SPACE}%"

OTHERS = "\N{OBJECT REPLACEMENT CHARACTER}"
"""Placeholder for the names of teachers that share a sentence."""


def findings(summary: pd.DataFrame, tests: pd.DataFrame) -> list[str]:
    """Return the sentences with which a comparison in a report begins, based on the headline measure.

    Args:
        summary: rows from `evaluations.summarise`.
        tests: rows from `pairwise.against_baseline`, of the same comparison.
    """
    evaluated = summary[summary["n"] > 0]
    if evaluated.empty:
        return ["No run has been evaluated yet."]
    if (evaluated[f"{PAPERS}_mean"] == 0).all() and not (evaluated[f"{HEADLINE}_mean"] > 0).any():
        return [
            "Nothing mastered: no seed masters any test task, so teachers are not compared. Their mean "
            "returns do not say which of them would master more."
        ]
    sooner, end = (tests[tests["measure"] == axis].set_index("teacher") for axis in (HEADLINE, FINAL))
    provisional = evaluated["provisional"].astype(bool)
    final, running = evaluated[~provisional], evaluated[provisional]
    sentences = []
    if len(final):
        final = final.sort_values(f"{HEADLINE}_mean", ascending=False, kind="stable")
        best = final.iloc[0]
        spread = f"mean ± standard deviation over {best['n']} seeds" if best["n"] > 1 else "1 seed"
        verb = "masters the most test tasks over training:" if len(final) > 1 else "masters over training"
        last = plus_minus(best[f"{FINAL}_mean"], best[f"{FINAL}_std"]) + UNIT
        value = f"{label(best['teacher'])} {verb} {_value(best)} ({spread})"
        sentences = [f"{value}; at the last three evaluations {last}.", *_certainty(final, sooner, end)]
    if len(final) == 1:
        sentences.append("No other teacher has finished." if len(running) else "Other teachers were not run.")
    for _, row in running.iterrows():
        gap = sooner["difference"].get(row["teacher"], math.nan)
        until = f", {_gap(gap)} than Random until that step" if math.isfinite(gap) else ""
        steps = f"So far, over {steps_text(row['step'])} steps"
        sentences.append(
            f"{steps}, {label(row['teacher'])} masters {_value(row)}{until}; its runs are still under way."
        )
    return sentences


def _value(row: pd.Series) -> str:
    return plus_minus(row[f"{HEADLINE}_mean"], row[f"{HEADLINE}_std"]) + UNIT


def _gap(difference: float) -> str:
    return f"{number(abs(difference))} points {'more' if difference >= 0 else 'less'}"


def _certainty(ranked: pd.DataFrame, sooner: pd.DataFrame, end: pd.DataFrame) -> list[str]:
    """Return sentences about the tests of finished teachers against Random, over training and at the end."""
    best = ranked["teacher"].iloc[0]
    if len(ranked) == 1:
        return []
    tests = sooner[sooner.index.isin(ranked["teacher"])]
    if (tests["reason"] == NO_BASELINE).all():
        return ["Random has not been run to its end here, so no test was made."]
    sentences, teachers = ["No teacher does better than Random."], dict[str, list[str]]()
    if not is_baseline(best):
        sentences = [_against_random(best, tests.loc[best], end.loc[best])]
    for teacher in sorted(tests.index.drop(best, errors="ignore"), key=label):
        words = on_both_axes(verdict(tests.loc[teacher]), verdict(end.loc[teacher]))
        teachers.setdefault(words, []).append(label(teacher))
    order = {str(words): rank for rank, words in enumerate(THAN)}
    for words in sorted(teachers, key=lambda words: (order.get(words, len(order)), words)):
        if words not in set(tests["reason"]):
            lead = THAN[Verdict(words)] if words in THAN else f"{words}, beside"
            sentences.append(f"{lead[0].upper()}{lead[1:]} Random: {listed(teachers[words])}.")
    few = few_seeds_warning(tests.loc[tests["reason"] == "", ["n", "reference_n"]].min().min())
    return [*sentences, *([few] if few else [])]


def _against_random(teacher: str, test: pd.Series, end: pd.Series) -> str:
    lead = f"That is {_gap(test['difference'])} than Random"
    if test["reason"] == "needs 2 seeds":
        return f"{lead}, but a single seed cannot tell skill from luck: nothing can be concluded."
    if test["reason"]:
        return f"{lead}; not tested ({test['reason']})."
    interval = (
        f"simultaneous 95 % interval {interval_text(test['simultaneous_low'], test['simultaneous_high'])}"
    )
    method = f"{METHODS[Method(test['method'])]}, {p_value(test['holm'])} after Holm"
    then = f" In the end it is {verdict(end)}." if verdict(end) in THAN else ""
    if test["holm"] < SIGNIFICANCE:
        return f"{lead} ({interval}), a significant difference ({method}).{then}"
    return (
        f"{lead} ({interval}), which may be chance: the seeds do not tell {label(teacher)} and Random apart "
        f"({method}).{then}"
    )


def ranking(frames: Frames, share: float = 1.0, measure: str = HEADLINE) -> pd.DataFrame:
    """Return the ranking of teachers on each challenge and level, from runs pooled as in the paper.

    Args:
        frames: results from `load`.
        share: share of the budget at which runs are measured.
        measure: name of one of `tested.MEASURES`.

    Returns:
        `POOLED`, runs, n, missing, mean and standard deviation of the measure and of the last three
        evaluations (as mastered_area_mean, last_three_std), worst (of a single run), rank (1 for the highest
        mean of a comparison), and of the test against Random family, the columns of `statistics.Comparison`
        but n, and `pairwise.CORRECTED`. Best first. Bodies and students have equal weight, and deviations
        are those within them.
    """
    return ranked(pooling.runs_after(frames, share, training=False), measure)


def ranked(runs: pd.DataFrame, measure: str = HEADLINE) -> pd.DataFrame:
    """Return the table of `ranking`, from rows of `pooling.runs_after`."""
    measures = list(dict.fromkeys([measure, FINAL]))
    table = pooling.pooled(runs, measures)
    parts = runs.groupby([*columns.POOLED, *columns.PARTS], dropna=False, sort=True)[measures]
    pools = list(range(len(columns.POOLED)))
    for name, values in parts.mean().groupby(level=pools, dropna=False).mean().items():
        table[f"{name}_mean"] = values.to_numpy()
    for name, values in parts.var().groupby(level=pools, dropna=False).mean().items():
        table[f"{name}_std"] = np.sqrt(values.to_numpy())
    tests = pairwise(runs, measure, BASELINE, detectable=False).rename(columns={"first": "teacher"})
    tested = ["measure", "family", *(name for name in TEST if name != "n"), *CORRECTED]
    table = table.merge(tests[[*columns.POOLED, *tested]], on=columns.POOLED, how="left")
    table["reason"] = table["reason"].fillna("")
    worst = runs.groupby(columns.POOLED, dropna=False, sort=True)[measure].min()  # same order as `table`
    table["worst"] = worst.to_numpy()
    means = table.groupby(columns.COMPARED, dropna=False)[f"{measure}_mean"]
    table["rank"] = means.rank(ascending=False, method="min")
    return table.sort_values([*columns.COMPARED, "rank", "teacher"], ignore_index=True)


def ranking_sentences(table: pd.DataFrame) -> list[str]:
    """Return sentences about the tests against Random in a `ranking`."""
    tested = table[table["p"].notna()].rename(columns={"teacher": "first"})
    return sentences(tested.assign(second=BASELINE))


def sentences(tests: pd.DataFrame) -> list[str]:
    """Return sentences about `tests` (rows from `pairwise.pairwise`), those against Random first.

    Opponents with the same verdicts share a sentence. Differences are significant where p is below 0.05 after
    Holm's correction.
    """
    order = tests.assign(last=[not is_baseline(name) for name in tests["second"]])
    varying = pooling.varying(order)
    same = ["environment", "expert_knowledge", *columns.CONDITIONS, "first"]
    names: dict[str, list[str]] = {}
    for _, rows in order.groupby([*same, "last", "second"], sort=True, dropna=False):
        row = rows.iloc[0]
        words = [
            title("environment", row["environment"]),
            f"expert knowledge {row['expert_knowledge']}",
            *pooling.condition_words(row, varying),
        ]
        sentence = f"{', '.join(words)}: {label(str(row['first']))} is {_verdicts(rows)}."
        names.setdefault(sentence, []).append(label(str(row["second"])))
    return [sentence.replace(OTHERS, listed(others)) for sentence, others in names.items()]


def _verdicts(rows: pd.DataFrame) -> str:
    tested = rows[rows["p"].notna()]
    if tested.empty:
        reasons = ", ".join(dict.fromkeys(rows["reason"]))
        return f"not tested against {OTHERS} ({reasons})"
    verdicts = tested.apply(verdict, axis=1)
    better, worse = int((verdicts == "better").sum()), int((verdicts == "worse").sum())
    few = few_seeds_suffix(tested[["n", "reference_n"]].min().min())
    of = counted(len(tested), "challenge")
    if not better and not worse:
        brief = few.replace("; ", " (") + ")" if few else ""
        return f"not distinguishable from {OTHERS} on any of {of}{brief}"
    best = f"better than {OTHERS} on {better} of {of}" if better else f"on none of {of} better than {OTHERS}"
    worst = f", worse on {worse}" if worse else ""
    return f"{best}{worst} (p < {SIGNIFICANCE} after Holm{few})"


def challenge_titles(table: pd.DataFrame) -> list[str]:
    """Return each row's challenge title, with the conditions that vary among rows of the challenge.

    Args:
        table: rows with the columns `COMPARED`.
    """
    several = ["pool", "test_sets", *(name for name in columns.CONDITIONS if name != "variant")]
    groups = table.groupby(columns.CHALLENGE_LEVEL)
    varies = {name: groups[name].transform("nunique", dropna=False) > 1 for name in several}
    titles = []
    for position, (_, row) in enumerate(table.iterrows()):
        title = challenge_title(row["environment"], row["challenge"])
        apart = [name for name in several if varies[name].iloc[position]]
        named = [str(row[name]) for name in apart if name not in columns.CONDITIONS and pd.notna(row[name])]
        words = pooling.condition_words(row, [name for name in apart if name in columns.CONDITIONS])
        titles.append(", ".join([title, *named, *words]))
    return titles

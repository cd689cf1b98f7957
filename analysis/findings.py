"""What a comparison says, in plain words, and how sure one may be."""

from __future__ import annotations

import math

import pandas as pd

from analysis.measures import is_baseline
from analysis.style import label

FEW_SEEDS = 10
"""Under this many seeds a sentence warns the reader; the paper used 16 to 48."""


def number(value: float, digits: int = 1) -> str:
    """Returns `value` with a true minus sign, or a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"  # noqa: RUF001
    return f"{value:.{digits}f}".replace("-", "−")  # noqa: RUF001


def plus_minus(mean: float, std: float, digits: int = 1) -> str:
    """Returns ``mean ± standard deviation``, the mean alone where one seed has no deviation."""
    if not math.isfinite(std):
        return number(mean, digits)
    return f"{number(mean, digits)} ± {number(std, digits)}"


def p_value(p: float) -> str:
    """Returns ``p = 0.012`` or ``p < 0.001``."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def amount(steps: float) -> str:
    """Returns a number of steps as people say it: ``20 million``, ``30 thousand``, ``500``."""
    for size, word in ((1e6, "million"), (1e3, "thousand")):
        if steps >= size:
            return f"{steps / size:.4g} {word}"
    return f"{steps:.0f}"


def verdict(test: pd.Series) -> str:
    """Returns what a test against Random found, in a word or two, or why there was none."""
    if test["reason"]:
        return str(test["reason"])
    if not test["p"] < 0.05:
        return "not distinguishable"
    return "better" if test["difference"] > 0 else "worse"


def findings(summary: pd.DataFrame, tests: pd.DataFrame) -> list[str]:
    """Returns the sentences that open a comparison.

    Args:
        summary: rows of `measures.summarise`, of one comparison.
        tests: rows of `measures.against_baseline` for both measures, of the same comparison.
    """
    read = summary[summary["n"] > 0]
    if read.empty:
        return ["No run has been evaluated yet."]
    sentences = []
    measure, unit = "mastered_percent", " %"
    if (read["mastered_percent_mean"] == 0).all():
        sentences.append(
            "No seed of any teacher masters a test task yet, so the teachers are compared by their mean "
            "return on the test set."
        )
        measure, unit = "evaluation_return", ""
    if read["provisional"].any():
        sentences.append("Runs are still under way: what follows is provisional.")
    tests = tests[tests["measure"] == measure].set_index("teacher")
    ranked = read.sort_values(f"{measure}_mean", ascending=False, kind="stable")
    sentences.append(_leader(ranked.iloc[0], measure, unit))
    return [*sentences, *_certainty(ranked, tests, unit)]


def _leader(best: pd.Series, measure: str, unit: str) -> str:
    value = plus_minus(best[f"{measure}_mean"], best[f"{measure}_std"]) + unit
    seeds = "1 seed" if best["n"] == 1 else f"{best['n']} seeds"
    spread = "" if best["n"] == 1 else "mean ± standard deviation over "
    what = "masters the most test tasks" if measure == "mastered_percent" else "has the highest test return"
    return f"{label(best['teacher'])} {what}: {value} ({spread}{seeds})."


def _certainty(ranked: pd.DataFrame, tests: pd.DataFrame, unit: str) -> list[str]:
    """Returns how far the order of the teachers can be trusted."""
    best = ranked.iloc[0]
    if len(ranked) == 1:
        return ["There is no other teacher to compare it with yet."]
    if not ranked["teacher"].map(is_baseline).any():
        reason = "no Random to compare with"
        if (tests["reason"] == reason).all():
            return ["Random is not among them, so no test was made."]
    if is_baseline(best["teacher"]):
        sentences = ["No teacher does better than Random."]
    else:
        sentences = [_against_random(best["teacher"], tests.loc[best["teacher"]], unit)]
    others = tests.drop(index=best["teacher"], errors="ignore")
    return [*sentences, *_others(others), *_few(tests)]


def _against_random(teacher: str, test: pd.Series, unit: str) -> str:
    points = " points" if unit else ""
    lead = f"That is {number(abs(test['difference']))}{points} more than Random"
    if test["reason"] == "needs 2 seeds":
        return f"{lead}, but a single seed cannot tell skill from luck: nothing can be concluded."
    if test["reason"]:
        return f"{lead}; not tested ({test['reason']})."
    interval = f"95 % confidence interval {number(test['low'])} to {number(test['high'])}"
    if test["p"] < 0.05:
        return f"{lead} ({interval}), a significant difference (Welch’s t-test, {p_value(test['p'])})."  # noqa: RUF001
    return (
        f"{lead} ({interval}), which may be chance: the seeds do not tell {label(teacher)} and Random apart "
        f"(Welch’s t-test, {p_value(test['p'])})."  # noqa: RUF001
    )


def _others(tests: pd.DataFrame) -> list[str]:
    sentences = []
    verdicts = tests.apply(verdict, axis=1) if len(tests) else pd.Series(dtype=object)
    for word, phrase in (
        ("better", "Also significantly better than Random"),
        ("worse", "Significantly worse than Random"),
        ("not distinguishable", "Not distinguishable from Random"),
    ):
        teachers = sorted(label(teacher) for teacher in verdicts[verdicts == word].index)
        if teachers:
            sentences.append(f"{phrase}: {', '.join(teachers)}.")
    return sentences


def _few(tests: pd.DataFrame) -> list[str]:
    tested = tests[tests["reason"] == ""]
    smallest = tested[["n", "reference_n"]].min().min() if len(tested) else FEW_SEEDS
    if smallest >= FEW_SEEDS:
        return []
    return [
        f"With {smallest} seeds only large differences can show, and their size is uncertain; "
        f"take this as an indication, not as a result."
    ]

"""Tables of the shipped releases, for the site."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from analysis.baselines import BaselineKind, baselines, find_baseline, newest_release
from analysis.commands.leaderboards import EXPLANATION, NO_BREAK, folded
from analysis.commands.leaderboards import markdown as leaderboard_of
from analysis.commands.simulated import BETTER, WORSE, markdown, mastered_table, recovery_table
from analysis.comparisons.against_random import Gap, against_random
from analysis.comparisons.leaderboards import leaderboards
from analysis.comparisons.pairwise import corrected, over_challenges, pairwise
from analysis.comparisons.planning import LITE
from analysis.formatting import steps_text
from analysis.measures.pooling import runs_after
from analysis.measures.run_measures import NEARLY_ALL, trained_shares
from analysis.measures.tested import AXES, HEADLINE, TRAINED, on_both_axes, verdict
from analysis.names import challenge_title, distinct_labels, label, short_title, teacher_order
from analysis.statistics import SIGNIFICANCE, Description, holm, welch, welch_from_statistics
from tma_ray.benchmark.experiments import TEACHERS as TEACHERS_OF_THE_PAPER
from tma_ray.campaign.simulated import played_runs
from tma_ray.results import Results
from tma_ray.support.component_names import base_name, split_name
from tma_ray.tasks import KnowledgeLevel
from tma_ray.testing import SIMULATED_CHALLENGES
from tma_ray.testing.matrix import cells_of, runs_of, tabulate

PICTURES = Path(__file__).parents[1] / "images" / "leaderboard"
"""Pictures of the curricula of releases, by ``make_leaderboard_pictures.py``."""

MEASURED = Path(__file__).parents[2] / "benchmarks" / "measured"
"""Results of benchmarks: ``trials.csv`` by ``trials.py``, ``sensitivity.csv`` by ``sensitivity.py``."""

SIMULATED_RELEASE = "simulated-1"

NOTHING = "\N{EN DASH}"
"""Mark of a cell without a number."""

ALIKE = "\N{MIDDLE DOT}"
"""Mark of a difference from Random that is not significant."""


def leaderboard(name: str) -> str:
    """Return the leaderboards of a release, definitions of terms, and pictures of curricula."""
    parts = [leaderboard_of(name, "images/leaderboard"), "## More"]
    parts.append(folded("What the columns are", "\n\n".join(EXPLANATION)))
    for strip in sorted(PICTURES.glob(f"{name}-*.png")):
        challenge = strip.stem.removeprefix(f"{name}-")
        title = challenge_title("stump_tracks", challenge, challenge)
        image = f"images/leaderboard/{strip.stem}"
        films = [
            f"[Film {number}](images/leaderboard/{film.name})"
            for number, film in enumerate(sorted(PICTURES.glob(f"{strip.stem}-*.gif")), start=1)
        ]
        picture = f"[![Probed tasks of each teacher over a run]({image}.png)]({image}.png)"
        parts.append(folded(f"Curricula: {title}", f"{', '.join(films)}\n\n{picture}"))
    return "\n\n".join(parts)


def answer() -> str:
    """Return sentences on the best teachers of the newest release."""
    baseline = newest_release()
    board = leaderboards(baseline.frames())[0]
    return (
        f"{board.answer()} Evidence: {baseline.manifest.holds['runs']:,} runs of "
        f"`{baseline.manifest.name}`, {steps_text(baseline.manifest.holds['steps'][0])} steps each."
    )


@functools.cache
def _simulated_runs() -> tuple[pd.DataFrame, int]:
    """Return the simulated runs with complete seeds, and the number of these seeds."""
    runs = played_runs(Results(find_baseline(SIMULATED_RELEASE).store()))
    teachers = sorted({run.teacher for run in runs}, key=teacher_order)
    cells = cells_of(teachers, SIMULATED_CHALLENGES, list(KnowledgeLevel))
    played = Counter(run.seed for run in runs)
    seeds = [seed for seed, number in played.items() if number == len(runs_of(cells))]
    frame = tabulate(cells, [run for run in runs if run.seed in seeds])
    return frame.assign(teacher=frame["teacher"].map(label)), len(seeds)


def simulated_students() -> str:
    """Return tables of simulated students: mastered tasks, and recovery after resets."""
    frame, seeds = _simulated_runs()
    mastered = mastered_table(frame).rename(columns=lambda name: name.replace("_", " "))
    tables = (markdown(table.map(_on_one_line)) for table in (mastered, recovery_table(frame)))
    titles = (
        f"After 10,000 episodes, {seeds} seeds:",
        "Around the first reset of the forgetting students:",
    )
    parts = (part for pair in zip(titles, tables, strict=True) for part in pair)
    return "\n\n".join(['<div class="leaderboard" markdown>', *parts, "</div>"])


def simulated_and_paper() -> str:
    """Return differences of the paper's teachers from Random, with simulated students and as published.

    Published results are compared by Welch's test at the same level of knowledge, with Holm's correction
    within a challenge; the paper has no result of Random on the original space.
    """
    here = mastered_table(_simulated_runs()[0])
    paper = find_baseline("paper-2021").published()
    paper = paper[paper["environment"] == "stump_tracks"]
    challenges = [name for name in here.columns if name in set(paper["challenge"]) - {"original"}]
    marks: dict[tuple[str, str], dict[str, str]] = {}
    for challenge in challenges:
        rows = [row for row in paper.to_dict("records") if row["challenge"] == challenge]
        random = {row["expert_knowledge"]: _described(row) for row in rows if row["teacher"] == "random"}
        others = [row for row in rows if row["teacher"] != "random"]
        tests = [welch_from_statistics(_described(row), random[row["expert_knowledge"]]) for row in others]
        for row, test, p in zip(others, tests, holm([test.p for test in tests]), strict=True):
            key = label(row["teacher"]), row["expert_knowledge"]
            same = here[
                (here["teacher"] == key[0]) & here["expert knowledge"].map(lambda of, k=key: k[1] in of)
            ]
            told = same[challenge].item()[-1]
            theirs = ALIKE if p >= SIGNIFICANCE else BETTER if test.difference > 0 else WORSE
            marks.setdefault(key, {})[challenge] = f"{told if told in (BETTER, WORSE) else ALIKE} / {theirs}"
    table = pd.DataFrame(
        [{"teacher": name, "expert knowledge": level, **row} for (name, level), row in marks.items()]
    )
    order = sorted(table.index, key=lambda row: list(here["teacher"]).index(table["teacher"][row]))
    return markdown(table.loc[order].fillna("").rename(columns=lambda name: name.replace("_", " ")))


def _described(row: Mapping[Hashable, Any]) -> Description:
    return Description(row["n"], row["mastered_percent_mean"], row["mastered_percent_std"])


def _on_one_line(text: str) -> str:
    """Return a mean with its margin, with no-break spaces."""
    return text.replace(" ", NO_BREAK) if "±" in text else text


def trials() -> str:
    """Return the errors and seeds of simulated trials, measured by `benchmarks/trials.py`."""
    rows = pd.read_csv(MEASURED / "trials.csv")
    table = pd.DataFrame(
        {
            "cells": rows["names"] + " (" + rows["cells"].astype(str) + ")",
            "true difference": rows["true"].map("{:+.1f}".format),
            "seeds": rows["seeds"].map("{:.1f}".format),
            "wrong, %": (100 * rows["wrong"]).map("{:.1f}".format),
            "wrong by own variances, %": (100 * rows["wrong_own_variances"]).map("{:.1f}".format),
            "wrong in the end, %": (100 * rows["wrong_in_the_end"]).map("{:.1f}".format),
            "against Random: better / worse / alike, %": _verdicts(rows, "random"),
            "against the best": _verdicts(rows, "best"),
            "bias, naive": rows["naive_bias"].map("{:+.2f}".format),
            "bias, median-unbiased": rows["median_bias"].map("{:+.2f}".format),
        }
    )
    return markdown(table)


def _verdicts(rows: pd.DataFrame, reference: str) -> pd.Series:
    shares = (100 * rows[f"{reference}_{verdict}"] for verdict in ("better", "worse", "alike"))
    parts = [share.map("{:.0f}".format) for share in shares]
    return parts[0].str.cat(parts[1:], sep=" / ")


def releases() -> str:
    """Return a table of the shipped baselines."""
    rows = []
    place = ["environment", "challenge", "embodiment", "student", "teacher", "expert_knowledge"]
    for baseline in baselines():
        manifest, seeds = baseline.manifest, NOTHING
        holds = manifest.holds
        steps = " and ".join(map(steps_text, holds["steps"]))
        if manifest.kind is BaselineKind.RUNS:
            seeds = baseline.frames().cells.groupby(place, observed=True)["seed"].nunique().max()
        runs, teachers = f"{holds['runs']:,}" if holds.get("runs") else NOTHING, len(holds["teachers"])
        name = f"`{manifest.name}`"
        rows.append([name, manifest.engine, *map(str, (runs, teachers, seeds)), steps, manifest.licence])
    return markdown(
        pd.DataFrame(
            rows,
            columns=["name", "engine", "runs", "teachers", "seeds of a cell, at most", "steps", "licence"],
        )
    )


def learning_of_releases() -> str:
    """Return the mean mastered tasks over all core runs, by step and release of real students."""
    curves = {}
    for name in LITE:
        baseline = find_baseline(name)
        frames = baseline.frames()
        core = frames.cells.loc[frames.cells["campaign"].isin(baseline.manifest.core), "run_id"]
        evaluations = frames.evaluations[frames.evaluations["run_id"].isin(core)]
        curves[f"`{name}`"] = 100 * evaluations.groupby("step")["mastered"].mean()
    table = pd.DataFrame(curves).dropna().T.map("{:.1f}".format)  # steps common to all releases
    table.columns = pd.Index([f"{step / 1e6:g} M" for step in table.columns])
    return markdown(table.rename_axis("mastered, %, after").reset_index())


def untrained() -> str:
    """Return the percentage of untrained steps by teacher, for releases of real students."""
    shares = {}
    for name in LITE:
        frames = find_baseline(name).frames()
        teachers = frames.cells.drop_duplicates("run_id").set_index("run_id")["teacher"]
        shares[f"`{name}`"] = 100 - trained_shares(frames).groupby(teachers.map(label)).mean()
    table = pd.DataFrame(shares)
    table = (
        table[(table > 100 - NEARLY_ALL).any(axis=1)].map("{:.0f}".format, na_action="ignore").fillna(NOTHING)
    )
    return markdown(table.rename_axis("steps without training, %").reset_index())


def later_teachers() -> str:
    """Return tests of the later teachers of `lite-2` (not the paper's) against Random and ALP-GMM.

    Both measures are tested over all challenges. Single challenges are listed if their test is significant
    after a correction for their number. Teachers that lack challenges have no row. The tests of each teacher
    are a separate family.
    """
    frames, runs = find_baseline("lite-2").frames(), _runs_of_lite_2()
    whole = runs.groupby("teacher")["challenge"].nunique()
    whole = whole[whole == whole.max()]
    later = [name for name in whole.index if base_name(name) not in TEACHERS_OF_THE_PAPER]
    trained = {each.teacher: each.gaps.get(TRAINED) for each in against_random(frames, runs)}
    names = distinct_labels(later)
    rows: dict[str, dict[str, str]] = {name: {} for name in sorted(later, key=teacher_order)}
    for reference in ("random", "alp_gmm"):
        both = {
            axis: {test["first"]: test for test in over_challenges(runs, axis, reference).to_dict("records")}
            for axis in AXES
        }
        single = pairwise(runs, HEADLINE, reference, detectable=False)
        for name, row in rows.items():
            gaps = {axis: Gap.of(tests[name]) for axis, tests in both.items()}
            for axis, words in AXES.items():
                row[f"{words}, less {label(reference)}"] = str(gaps[axis])
            said = on_both_axes(*(gaps[axis].verdict for axis in AXES))
            if reference == "random" and (gap := trained[name]):
                said += f"; per trained step {gap} {gap.verdict}"
            row[f"verdict beside {label(reference)}"] = said
        single = corrected(single[single["first"].isin(later)], ["first"])
        own = single[single["holm"] < SIGNIFICANCE]
        for name, row in rows.items():
            places = own[own["first"] == name]
            row[f"alone, beside {label(reference)}"] = _places(places) or NOTHING
    return markdown(pd.DataFrame([{"teacher": names[name], **row} for name, row in rows.items()]))


def _places(tests: pd.DataFrame) -> str:
    """Return the challenges of significant tests as text, grouped into "sooner" and "later"."""
    words = {"better": "sooner", "worse": "later"}
    found: dict[str, list[str]] = {}
    for _, test in tests.iterrows():
        title = challenge_title(test["environment"], test["challenge"], test["challenge"])
        found.setdefault(words[verdict(test)], []).append(short_title(title))
    return "; ".join(f"{word}: {', '.join(places)}" for word, places in sorted(found.items(), reverse=True))


def budget_rule() -> str:
    """Return tests of settings fitted to the budget against their authors' values, for teachers of `lite-2`.

    Both settings differ in the budget alone, and are compared over all challenges on which both have results.
    Holm's correction covers all rows.
    """
    runs = dict(list(_runs_of_lite_2().groupby("teacher")))
    pairs = [(name, base_name(name)) for name in sorted(runs) if split_name(name)[1].keys() == {"budget"}]
    rows: dict[str, dict[str, str]] = {}
    for axis, words in AXES.items():
        both = [
            over_challenges(pd.concat([runs[fitted], runs[authors]]), axis, authors)
            for fitted, authors in pairs
            if authors in runs
        ]
        for test in corrected(pd.concat(both), ["measure"]).to_dict("records"):
            row = rows.setdefault(label(test["second"]), {"challenges": str(test["challenges"])})
            row["runs, fitted and not"] = f"{test['n']}, {test['reference_n']}"
            row[f"fitted, less authors' values: {words}"] = f"{Gap.of(test)}, {verdict(test)}"
    return markdown(pd.DataFrame([{"teacher": name, **row} for name, row in rows.items()]))


@functools.cache
def _runs_of_lite_2() -> pd.DataFrame:
    """Return the runs of `lite-2` on Stump Tracks at the highest level of expert knowledge."""
    runs = runs_after(find_baseline("lite-2").frames())
    return runs[(runs["environment"] == "stump_tracks") & (runs["expert_knowledge"] == KnowledgeLevel.HIGH)]


def sensitivity() -> str:
    """Return a table of tasks mastered in the end by variants of PPO, from `benchmarks/sensitivity.py`."""
    table = pd.read_csv(MEASURED / "sensitivity.csv")
    last = table[table["step"] == table["step"].max()]
    cells = dict(list(last.groupby(["embodiment", "student"], sort=False)["mastered"]))
    rows, reference = [], cells["classic_bipedal", "ppo"]
    for (body, student), mastered in cells.items():
        difference = ""
        if mastered is not reference:
            test = welch(mastered, reference)
            difference = f"{test.difference:+.1f} [{test.low:+.1f}, {test.high:+.1f}]"
        variant = f"`{student}`, {body.replace('_', ' ')}"
        rows.append((variant, f"{mastered.mean():.1f}", f"{mastered.std():.1f}", difference))
    heads = ["variant", "mastered, %", "deviation over seeds", "difference"]
    return markdown(pd.DataFrame(rows, columns=heads))

"""Pilot of docs/long_runs.md, which selects the student of the long runs, without Ray.

    python benchmarks/parkour_pilot.py --results build/parkour_pilot --processes 1 --minutes 600
    python benchmarks/parkour_pilot.py --tables

Executes the runs that are missing in benchmarks/measured/parkour_pilot.csv, continues interrupted ones, and
adds the evaluations of finished runs to that file.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import pandas as pd
from pilot import MEASURED, areas, done, key_of, markdown, noise_of, read, shown, written
from pools import execute, parser

from tma_ray.campaign.plan import CampaignSpec, Plan
from tma_ray.runs import Cell, Schedule
from tma_ray.students.catalogue import canonical_student
from tma_ray.tasks import KnowledgeLevel

STUDENTS = ("ppo:preset=decisive", "ppo")
"""Candidates; the first wins a tie."""

TEACHERS = ("random", "alp_gmm")

WALKER = "classic_bipedal"

BODIES = (WALKER, "fish")

SEEDS = (1000, 1001)

MILLIONS = 3, 4, 5, 6
"""Budgets for which signal to noise is shown, in millions of steps."""

LITE_MILLIONS = MILLIONS[1:]
"""Candidate budgets of tier lite, in millions of steps."""

ENOUGH = 0.95
"""Share of the highest decisiveness that suffices for a smaller budget."""


def plan() -> Plan:
    """Return the plan of the 16 runs, ordered by seed."""
    cells = tuple(
        Cell("parkour", "original", body, student, teacher, KnowledgeLevel.LOW)
        for student in STUDENTS
        for body in BODIES
        for teacher in TEACHERS
    )
    schedule = Schedule(10**6 * MILLIONS[-1], 250_000, 250_000, training_window=100_000)
    whole = CampaignSpec("parkour_pilot", cells, SEEDS, schedule).plan()
    return replace(whole, runs=tuple(sorted(whole.runs, key=lambda run: run.seed)))


def of_student(runs: pd.DataFrame, student: str) -> pd.DataFrame:
    """Return the runs of a student, given any spelling of its settings."""
    return runs[runs["student"] == canonical_student(student)]


def chosen_student(evaluations: pd.DataFrame) -> str:
    """Return the student that is selected by the first rule of the page."""
    runs = areas(evaluations)
    signals = {student: noise_of(of_student(runs, student), "last_three").value for student in STUDENTS}
    best, other = sorted(STUDENTS, key=lambda student: -signals[student])
    walkers = runs[runs["embodiment"] == WALKER]
    mastered = {student: of_student(walkers, student)["last_three"].mean() for student in STUDENTS}
    return other if mastered[best] < mastered[other] / 2 else best


def chosen_budget(evaluations: pd.DataFrame, student: str) -> int:
    """Return the budget (million steps) of walkers and swimmers in tier lite, by the second rule of the page.

    Steps are used in place of core-hours, which are proportional to them.
    """
    runs = of_student(evaluations, student)
    decisiveness = {
        millions: noise_of(areas(runs, millions * 10**6), "last_three").value / math.sqrt(millions)
        for millions in LITE_MILLIONS
    }
    best = max(decisiveness.values())
    if not best:
        return LITE_MILLIONS[-1]
    return min(millions for millions, value in decisiveness.items() if value >= ENOUGH * best)


def tables(evaluations: pd.DataFrame) -> str:
    """Return tables of mastered tasks of all runs over time, and of both students' signal to noise."""
    curves = evaluations.set_index("step").sort_index()
    by_run = []
    for (body, teacher, student, seed), run in curves.groupby(["embodiment", "teacher", "student", "seed"]):
        at = [f"{run['mastered_percent'].get(10**6 * millions, math.nan):.0f}" for millions in range(1, 7)]
        by_run.append((body, teacher, f"`{student}`", seed, *at))
    head = ("body", "teacher", "student", "seed", *(f"{millions} M" for millions in range(1, 7)))
    rows = []
    for student in STUDENTS:
        for millions in MILLIONS:
            runs = of_student(areas(evaluations, millions * 10**6), student)
            if len(runs):
                means = runs.groupby("embodiment")["last_three"].mean()
                signals = (shown(noise_of(runs, measure)) for measure in ("area", "last_three"))
                rows.append(
                    (
                        f"`{student}`",
                        millions,
                        *(f"{means.get(body, math.nan):.1f}" for body in BODIES),
                        *signals,
                        len(runs),
                    )
                )
    measures = ("student", "million steps", "walker, last three, %", "fish, last three, %")
    signal_table = markdown((*measures, "S/N of area", "S/N of last three", "runs"), rows)
    return f"{markdown(head, by_run)}\n\n{signal_table}"


def main() -> int:
    """Print tables, or execute missing runs."""
    options = parser(str(__doc__))
    options.add_argument(
        "--csv", type=Path, default=MEASURED / "parkour_pilot.csv", help="file of evaluations"
    )
    options.add_argument("--tables", action="store_true", help="print tables and choices, and run nothing")
    given = options.parse_args([*(["--results", ""] if "--tables" in sys.argv else []), *sys.argv[1:]])
    evaluations = read(given.csv) if given.csv.exists() else pd.DataFrame()
    ended = done(evaluations) if len(evaluations) else set()
    wanted = plan()
    missing = tuple(run for run in wanted.runs if key_of(run) not in ended)
    if given.tables:
        print(tables(written(given.results, given.csv) if given.results else evaluations))
    elif missing:
        execute(replace(wanted, runs=missing), given)
        evaluations = written(given.results, given.csv)
        missing = tuple(run for run in wanted.runs if key_of(run) not in done(evaluations))
    print(f"{len(wanted.runs) - len(missing)} of {len(wanted.runs)} runs are done")
    if not missing:
        student = chosen_student(evaluations)
        print(f"student: {student}; tier lite: {chosen_budget(evaluations, student)} million steps")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

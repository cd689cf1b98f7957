"""Pilot of docs/pilot.md, which selects student, budget and evaluations of the next release, without Ray.

    python benchmarks/pilot.py --costs
    python benchmarks/pilot.py --results build/pilot --processes 1 --minutes 600
    python benchmarks/pilot.py --tables

Executes the parts one after the other, and continues interrupted runs. All evaluations are written to
benchmarks/measured/pilot.csv, costs to benchmarks/measured/pilot_costs.csv. Runs that are in the file of
evaluations, from any root, are not repeated. Its column walking marks runs of part c whose students started
from walking policies, which was possible for this part alone.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import pandas as pd
from pools import execute, parser
from seed_statistics import signal_to_noise

import analysis
from analysis.data.loading import evaluation_measures
from analysis.statistics.samples import Estimate
from tma_ray.campaign.plan import CampaignSpec, Plan, joined_plan
from tma_ray.envs import make_environment
from tma_ray.runs import Cell, RunSpec, Schedule, effective_spec
from tma_ray.students import check_hyperparameters, make_student
from tma_ray.students.catalogue import canonical_student
from tma_ray.tasks import KnowledgeLevel, TaskSpace

if TYPE_CHECKING:
    from student_training import OurLoop

MEASURED = Path(__file__).parent / "measured"

PAPER = "ppo"

ROLLOUTS = (PAPER, "ppo:steps_per_update=20000", "ppo:batch_size=1024:steps_per_update=32768")

TEACHERS = ("random", "alp_gmm", "spdl", "goal_gan:preset=release")

SPACES = (
    ("original", "classic_bipedal"),
    ("mostly_unfeasible", "classic_bipedal"),
    ("diverse_students", "spider"),
)
"""Task spaces: challenge and body."""

CELL = ["challenge", "embodiment", "teacher", "student"]
"""Columns of a sample."""

RUN = [*CELL, "steps", "seed"]
"""Columns of a run."""

INTERVAL = 250_000
"""Steps between evaluations of the present schedule; the screening has twice as many evaluations."""

STEPS = 2_000_000
"""Budget of the paper's student, whose core-seconds are the budget of all students."""

MILLIONS = 1, 2, 3, 4, 5
"""Budgets evaluated in part "budget", in millions of steps."""

SEEDS = {"screen": tuple(range(1000, 1004)), "budget": tuple(range(1004, 1007))}

ENOUGH = 1.3
"""Least signal to noise for a new release, as a ratio to that of the paper's student."""

STRETCH, STRETCHES = 40_000, 5
"""Least number of steps of a measurement of costs, and number of measurements."""

PARTS = ("rollouts", "changes", "students", "budget")

WALKER_STEPS = 1_000_000
"""Training steps of the walking policies."""


def changed(rollouts: str) -> dict[str, str]:
    """Return the students of the second half of the screening, by the name of their change."""
    hyper = check_hyperparameters(rollouts)
    changes: dict[str, dict[str, Any]] = {
        "small batches": {"batch_size": 500 if hyper.batch_size == 1_000 else 512, "gamma": 0.995},
        "small networks": {"activation": "tanh", "hidden_units": (64, 64), "separate_trunks": True},
        "dcd": {"entropy_coefficient": 0.001, "gae_lambda": 0.9, "value_clip_range": None},
        "averaged weights": {"averaged_steps": 100_000},
    }
    own = {key: getattr(hyper, key) for key in ("steps_per_update", "batch_size")}
    return {name: canonical_student(PAPER, own | change) for name, change in changes.items()}


def costs() -> pd.DataFrame:
    """Return the processor time of a training step by student, in µs, and the ratio to the paper's student.

    Students are measured alternately, since other load of the machine then affects all of them.
    """
    students = [*ROLLOUTS, *(name for rollouts in ROLLOUTS for name in changed(rollouts).values())]
    loops = {name: loop_of(name) for name in students}
    spent: dict[str, list[float]] = {name: [] for name in students}
    for repeat in range(STRETCHES + 1):
        for name, loop in loops.items():
            length = check_hyperparameters(name).steps_per_update
            steps = -(-STRETCH // length) * length if repeat else length
            start = time.process_time()
            loop.train(steps)
            if repeat:
                spent[name].append(1e6 * (time.process_time() - start) / steps)
    ratios = {
        name: statistics.median(own / paper for own, paper in zip(values, spent[PAPER], strict=True))
        for name, values in spent.items()
    }
    rows = [(name, round(statistics.median(spent[name]), 1), round(ratios[name], 3)) for name in students]
    return pd.DataFrame(rows, columns=["student", "microseconds", "ratio"])


class Tasks(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Wrapper that resets an environment to random tasks of a space."""

    def __init__(self, env: gymnasium.Env[Any, Any], space: TaskSpace) -> None:
        super().__init__(env)
        self._space, self._rng = space, np.random.default_rng(0)

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment to a random task."""
        return self.env.reset(**options | {"options": {"task": self._space.sample(self._rng, 1)[0]}})


def loop_of(student: str) -> OurLoop:
    """Return the training loop of a student on random tasks."""
    from student_training import OurLoop  # deferred: imports torch

    spec = effective_spec(Cell(student=student), 0, Schedule())
    env = Tasks(make_environment(spec.environment, **spec.environment_options), spec.task_space)
    entropy = np.random.SeedSequence(0)
    return OurLoop(make_student(student, env.observation_space, env.action_space, entropy), env)


def read(csv: Path) -> pd.DataFrame:
    """Read a table of results, with canonical names of students (presets may be newer than the table)."""
    table = pd.read_csv(csv)
    return table.assign(student=table["student"].map(canonical_student))


def step_costs() -> pd.DataFrame:
    """Return the measured cost of a training step by student: microseconds and ratio."""
    return read(MEASURED / "pilot_costs.csv").set_index("student")


def steps_of(student: str) -> int:
    """Return the budget that takes a student as many core-seconds as `STEPS` take the paper's student."""
    if student in ROLLOUTS:
        return STEPS
    ratio = step_costs().ratio[student]
    return int(np.clip(round(STEPS / ratio / INTERVAL) * INTERVAL, STEPS, 2 * STEPS))


def plan(part: str, found: pd.DataFrame) -> Plan:
    """Return the plan of a part, given the evaluations of earlier parts."""
    chosen: list[tuple[str, str, str, str, int, int, tuple[int, ...]]]
    if part == "students":
        chosen = [
            (student, challenge, body, teacher, steps_of(student), INTERVAL, SEEDS["screen"])
            for student in finalists(found)
            for challenge, body in SPACES
            for teacher in TEACHERS
            if (challenge, teacher) != ("original", "random")  # already in the screening
        ]
    elif part == "budget":
        chosen = [
            (
                student_of_choice(found),
                challenge,
                body,
                teacher,
                MILLIONS[-1] * 10**6,
                INTERVAL,
                SEEDS["budget"],
            )
            for challenge, body in SPACES
            for teacher in TEACHERS
        ]
    else:
        students = ROLLOUTS if part == "rollouts" else changed(best_rollouts(found)).values()
        chosen = [
            (student, *SPACES[0], TEACHERS[0], steps_of(student), INTERVAL // 2, SEEDS["screen"])
            for student in students
        ]
    name = f"pilot_{part}"
    campaigns = [
        CampaignSpec(
            name,
            (Cell("stump_tracks", challenge, body, student, teacher, KnowledgeLevel.HIGH),),
            seeds,
            Schedule(steps, interval, INTERVAL, training_window=100_000),
        )
        for student, challenge, body, teacher, steps, interval, seeds in chosen
    ]
    return joined_plan(name, campaigns)


def evaluations(root: str, run_ids: Collection[str] | None = None) -> pd.DataFrame:
    """Return mastered % at all evaluations of runs, over all test tasks and over those with even index."""
    frames = analysis.load(root)
    rows = frames.evaluations
    if run_ids is not None:
        rows = rows[rows["run_id"].isin(run_ids)]
    halves = evaluation_measures(rows[rows["task_index"] % 2 == 0]).rename(
        columns={"mastered_percent": "mastered_half"}
    )
    found = frames.measured[["run_id", "step", "mastered_percent"]]
    found = found.merge(halves[["run_id", "step", "mastered_half"]], on=["run_id", "step"])
    runs = frames.cells.drop_duplicates("run_id")[["run_id", *CELL, "seed", "steps"]]
    rows = runs.merge(found, on="run_id").astype(dict.fromkeys(CELL, str) | {"steps": int})
    return rows.assign(walking=False)


def areas(found: pd.DataFrame, until: int | None = None, column: str = "mastered_percent") -> pd.DataFrame:
    """Return mean mastered % over training and over the last three evaluations, of runs that reached `until`.

    Args:
        found: evaluations of runs.
        until: step, by default the budget of each run.
        column: measure of the evaluations.
    """
    rows = []
    for key, run in found.groupby(RUN, observed=True):
        end = until or key[-2]
        curve = run[run["step"] <= end].set_index("step")[column]
        if curve.index[-1] == end:
            area = np.trapezoid(curve, curve.index) / end
            rows.append((*key, area, curve.iloc[-3:].mean()))
    return pd.DataFrame(rows, columns=[*RUN, "area", "last_three"])


def every_second(found: pd.DataFrame) -> pd.DataFrame:
    """Return every second evaluation, as in the present schedule."""
    return found[found["step"] % INTERVAL == 0]


def screened(found: pd.DataFrame) -> pd.DataFrame:
    """Return mean and deviation of the measures of `areas` by student of the screening, best first."""
    runs = areas(every_second(found))
    runs = runs[(runs["challenge"] == "original") & (runs["teacher"] == "random")]
    runs = runs[runs["seed"].isin(SEEDS["screen"])]
    table = runs.groupby("student")[["area", "last_three"]].agg(["mean", "std", "count"])
    return table.sort_values(("area", "mean"), ascending=False)


def best_rollouts(found: pd.DataFrame) -> str:
    """Return the student of `ROLLOUTS` with the highest mean area."""
    return str(screened(found).loc[list(ROLLOUTS), ("area", "mean")].idxmax())


def finalists(found: pd.DataFrame) -> list[str]:
    """Return the two best students of the screening, besides the paper's."""
    return [student for student in screened(found).index if student != PAPER][:2]


def noise_of(runs: pd.DataFrame, measure: str) -> Estimate:
    """Return the signal-to-noise ratio of one student's runs, on the square root of a measure."""
    strata = [
        {str(teacher): np.sqrt(own[measure].to_numpy()) for teacher, own in space.groupby("teacher")}
        for _, space in runs.groupby(["challenge", "embodiment"])
    ]
    return signal_to_noise(strata)


def student_of_choice(found: pd.DataFrame) -> str:
    """Return the student that is selected by the rule of part a."""
    runs = areas(every_second(found))
    runs = runs[runs["seed"].isin(SEEDS["screen"])]
    best = finalists(found)
    ratios = {student: noise_of(runs[runs["student"] == student], "area").value for student in best}
    if min(ratios.values()) >= 0.9 * max(ratios.values()):
        means = runs[runs["student"].isin(best)].groupby("student")["area"].mean()
        return str(means.idxmax())
    return max(best, key=ratios.__getitem__)


def pays(found: pd.DataFrame) -> bool:
    """Return True if the selected student is good enough for a new release."""
    runs = areas(every_second(found))
    own = runs[(runs["student"] == student_of_choice(found)) & runs["seed"].isin(SEEDS["screen"])]
    return noise_of(own, "area").value >= ENOUGH * noise_of(paper_runs(), "area").value


def tables(found: pd.DataFrame) -> str:
    """Return the available results as Markdown tables."""
    parts = [screen_table(found), schedule_table(found)]
    compared = found[found["seed"].isin(SEEDS["screen"]) & (found["student"] != PAPER)]
    if students := complete(areas(every_second(compared))):
        parts.append(comparison_table(complete(paper_runs()) | students))
    later = found[found["seed"].isin(SEEDS["budget"])]
    if complete(areas(later)):
        parts += [budget_table(later[~later["walking"]]), onset_table(later)]
    return "\n\n".join(parts)


def paper_runs() -> pd.DataFrame:
    """Return the runs of the paper's student in lite-1 under the conditions of the pilot."""
    cells = analysis.load("lite-1").cells
    wanted = (cells["student"] == PAPER) & (cells["expert_knowledge"] == "high") & (cells["seed"] < 5)
    wanted &= cells["teacher"].isin(TEACHERS) & cells["challenge"].isin([name for name, _ in SPACES])
    runs = areas(evaluations("lite-1", set(cells[wanted]["run_id"])))
    return runs[pd.MultiIndex.from_frame(runs[["challenge", "embodiment"]]).isin(SPACES)]


def complete(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the runs of students with two or more seeds of all teachers on all spaces."""
    found = {}
    for student, own in runs.groupby("student"):
        seeds = own.groupby(CELL)["seed"].count()
        if len(seeds) == len(TEACHERS) * len(SPACES) and seeds.min() > 1:
            found[str(student)] = own
    return found


def markdown(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(str(cell) for cell in line)} |" for line in lines)


def screen_table(found: pd.DataFrame) -> str:
    """Return a table of the students of the screening, best first."""
    ratios = step_costs().ratio
    rows = [
        (
            f"`{student}`",
            f"{ratios[str(student)]:.2f}",
            f"{steps_of(str(student)) / 1e6:g}",
            *(
                f"{row[measure, 'mean']:.1f} ± {row[measure, 'std']:.1f}"
                for measure in ("area", "last_three")
            ),
            int(row["area", "count"]),
        )
        for student, row in screened(found).iterrows()
    ]
    head = ("student", "cost of a step", "million steps", "area, %", "last three, %", "seeds")
    return markdown(head, rows)


def schedule_table(found: pd.DataFrame) -> str:
    """Return a table of two evaluation schedules: slope and residual deviation against all evaluations."""
    dense = found[found["step"] % INTERVAL != 0].groupby(RUN).size().index
    runs = found.set_index(RUN).loc[dense].reset_index()
    truth = areas(runs)["area"].to_numpy()
    rows = []
    for name, area in (
        ("every 250,000 steps, all tasks", areas(every_second(runs))["area"]),
        ("every 125,000 steps, half of the tasks", areas(runs, column="mastered_half")["area"]),
    ):
        slope = float(area @ truth / (truth @ truth))
        rows.append((name, f"{slope:.3f}", f"{(area / slope - truth).std():.2f}", len(area)))
    return markdown(("schedule", "slope", "deviation of residuals, points", "runs"), rows)


def shown(estimate: Estimate) -> str:
    """Return an estimate with its interval, as text."""
    return f"{estimate.value:.2f} [{estimate.low:.2f}, {estimate.high:.2f}]"


def comparison_table(students: Mapping[str, pd.DataFrame]) -> str:
    """Return a table of mean area and signal to noise by student."""
    rows = [
        (
            f"`{student}`",
            f"{runs['area'].mean():.1f}",
            f"{runs['last_three'].mean():.1f}",
            shown(noise_of(runs, "area")),
            shown(noise_of(runs, "last_three")),
            len(runs),
        )
        for student, runs in students.items()
    ]
    head = ("student", "area, %", "last three, %", "S/N of area", "S/N of last three", "runs")
    return markdown(head, rows)


def budget_table(found: pd.DataFrame) -> str:
    """Return a table of signal to noise and decisiveness by budget."""
    micro = step_costs().microseconds
    rows = []
    for millions in MILLIONS:
        for student, runs in complete(areas(found, millions * 10**6)).items():
            hours = millions * micro[student] / 3600
            area, last = (noise_of(runs, measure) for measure in ("area", "last_three"))
            decisive = (f"{each.value / math.sqrt(hours):.2f}" for each in (area, last))
            rows.append((millions, shown(area), shown(last), *decisive, len(runs)))
    head = (
        "million steps",
        "S/N of area",
        "S/N of last three",
        "decisiveness of area",
        "of last three",
        "runs",
    )
    return markdown(head, rows)


def onset_table(found: pd.DataFrame) -> str:
    """Return a table of signal to noise and decisiveness of new and of walking students, on two spaces.

    Args:
        found: evaluations of one student, new or started from the walking policy of its seed.
    """
    (micro,) = step_costs().microseconds[found["student"].unique()]
    found = found[pd.MultiIndex.from_frame(found[["challenge", "embodiment"]]).isin(SPACES[:2])]
    rows = []
    for name, own, steps in (
        ("new", found[~found["walking"]], STEPS),
        ("walking", found[found["walking"]], STEPS + WALKER_STEPS),
    ):
        runs = areas(own, STEPS)
        area, hours = noise_of(runs, "area"), steps * micro / 3.6e9
        decisive = f"{area.value / math.sqrt(hours):.2f}"
        rows.append((name, f"{runs['area'].mean():.1f}", shown(area), decisive, len(runs)))
    return markdown(("students", "area, %", "S/N of area", "decisiveness", "runs"), rows)


def written(root: str, csv: Path) -> pd.DataFrame:
    """Add the evaluations of a root's finished runs to a file, and return the whole table."""
    earlier = [read(csv)] if csv.exists() else []
    table = pd.concat([*earlier, evaluations(root)]).drop_duplicates([*RUN, "step"])
    table = table[pd.MultiIndex.from_frame(table[RUN]).isin(done(table))]
    table.sort_values([*RUN, "step"]).to_csv(csv, index=False)
    return read(csv)


def done(found: pd.DataFrame) -> set[tuple[object, ...]]:
    """Return the finished runs, as values of the columns `RUN`."""
    return set(found.loc[found["step"] == found["steps"], RUN].itertuples(index=False, name=None))


def key_of(run: RunSpec) -> tuple[object, ...]:
    """Return a run as values of the columns `RUN`."""
    return (*(getattr(run, column) for column in CELL), run.schedule.steps, run.seed)


def main() -> int:
    """Measure costs, print tables, or execute missing runs."""
    options = parser(str(__doc__))
    options.add_argument("--parts", default=",".join(PARTS), help="in this order")
    options.add_argument("--csv", type=Path, default=MEASURED / "pilot.csv", help="file of all evaluations")
    options.add_argument("--costs", action="store_true", help="measure the costs of steps only")
    options.add_argument("--tables", action="store_true", help="print what the root or the CSV says only")
    reads = {"--costs", "--tables"} & set(sys.argv)
    given = options.parse_args([*(["--results", ""] if reads else []), *sys.argv[1:]])
    if given.costs:
        table = costs()
        print(table.to_string())
        table.to_csv(MEASURED / "pilot_costs.csv", index=False)
        return 0
    if given.tables:
        print(tables(written(given.results, given.csv) if given.results else read(given.csv)))
        return 0
    found = read(given.csv) if given.csv.exists() else pd.DataFrame(columns=[*RUN, "step"])
    for part in given.parts.split(","):
        wanted = plan(part, found)
        missing = tuple(run for run in wanted.runs if key_of(run) not in done(found))
        print(f"{part}: {len(missing)} of {len(wanted.runs)} runs are missing", flush=True)
        if missing:
            execute(replace(wanted, runs=missing), given)
            found = written(given.results, given.csv)
        if not done(found).issuperset(map(key_of, wanted.runs)):
            break  # continued by the next call
        if part == "students" and not pays(found):
            print(f"no student has {ENOUGH} times the paper's signal to noise: the rest is left out")
            break
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

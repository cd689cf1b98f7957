"""The pilot of docs/pilot.md, which chooses student, budget and evaluations of the next release, without Ray.

    python benchmarks/pilot.py --costs
    python benchmarks/pilot.py --results build/pilot --processes 1 --minutes 600
    python benchmarks/pilot.py --tables

Runs the parts in order, each once the one before is done, and continues what an earlier call left. All
evaluations are written to benchmarks/measured/pilot.csv, costs to benchmarks/measured/pilot_costs.csv.
"""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pandas as pd
from pools import describe, execute, parser
from student_training import OurLoop

import analysis
from analysis.data.evaluations import evaluation_measures
from analysis.statistics.estimates import Estimate, signal_to_noise
from tma_ray.campaign.matrices import joined_plan
from tma_ray.campaign.plan import CampaignSpec, Plan
from tma_ray.runs import Cell, Schedule
from tma_ray.students import check_hyperparameters, make_student
from tma_ray.students.catalogue import canonical_student
from tma_ray.tasks import KnowledgeLevel, TaskSpace

MEASURED = Path(__file__).parent / "measured"

PAPER = "ppo"

ROLLOUTS = (PAPER, "ppo:steps_per_update=20000", "ppo:batch_size=1024:steps_per_update=32768")

TEACHERS = ("random", "alp_gmm", "spdl", "goal_gan:preset=release")

SPACES = (
    ("original", "classic_bipedal"),
    ("mostly_unfeasible", "classic_bipedal"),
    ("diverse_students", "spider"),
)
"""Challenge and body."""

CELL = ["challenge", "embodiment", "teacher", "student"]
"""Columns that tell the samples apart."""

INTERVAL = 250_000
"""Steps between evaluations; the screen has twice as many."""

STEPS = 2_000_000
"""Budget of the paper's student, whose core-seconds all have."""

MILLIONS = 1, 2, 3, 4, 5
"""Budgets that part "budget" is read at."""

SEEDS = {"screen": range(1000, 1004), "budget": range(1004, 1007)}

STRETCH, STRETCHES = 40_000, 5
"""Fewest steps by which costs are measured, and how often."""

PARTS = ("rollouts", "changes", "students", "budget")


def changed(rollouts: str) -> dict[str, str]:
    """Returns the students of the second half of the screen, by the name of their change."""
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
    """Returns the processor time of a training step of each student, in µs, and its ratio to the paper's.

    All students take turns, so that what else the machine does meets all of them.
    """
    students = [*ROLLOUTS, *(name for rollouts in ROLLOUTS for name in changed(rollouts).values())]
    loops = {student: RandomTasks(student) for student in students}
    spent: dict[str, list[float]] = {student: [] for student in students}
    for repeat in range(STRETCHES + 1):
        for student, loop in loops.items():
            length = check_hyperparameters(student).steps_per_update
            steps = -(-STRETCH // length) * length if repeat else length
            start = time.process_time()
            loop.train(steps)
            if repeat:
                spent[student].append(1e6 * (time.process_time() - start) / steps)
    ratios = {
        student: statistics.median(own / paper for own, paper in zip(values, spent[PAPER], strict=True))
        for student, values in spent.items()
    }
    rows = [(name, round(statistics.median(spent[name]), 1), round(ratios[name], 3)) for name in students]
    return pd.DataFrame(rows, columns=["student", "microseconds", "ratio"])


class RandomTasks(OurLoop):
    """A student that trains on random tasks of the original space, one after the other."""

    def __init__(self, name: str) -> None:
        env = gymnasium.make("tma_ray.envs:tma_ray/StumpTracks-v0")
        seed = np.random.SeedSequence(0)
        super().__init__(make_student(name, env.observation_space, env.action_space, seed), Tasks(env))


class Tasks(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Resets an environment with random tasks of its own space."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        self._space: TaskSpace = env.get_wrapper_attr("task_space")
        self._rng = np.random.default_rng(0)

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Returns the first observation of a random task."""
        return self.env.reset(**options | {"options": {"task": self._space.sample(self._rng, 1)[0]}})


def steps_of(student: str) -> int:
    """Returns the budget with which `student` has as many core-seconds as the paper's with `STEPS`."""
    if student in ROLLOUTS:
        return STEPS
    ratio = pd.read_csv(MEASURED / "pilot_costs.csv").set_index("student").ratio[student]
    return int(np.clip(round(STEPS / ratio / INTERVAL) * INTERVAL, STEPS, 2 * STEPS))


def plan(part: str, found: pd.DataFrame) -> Plan:
    """Returns the runs of `part`, given the evaluations of the parts before."""
    if part == "students":
        chosen = [
            (student, challenge, body, teacher, steps_of(student), INTERVAL, SEEDS["screen"])
            for student in screened(found).index[:2]
            for challenge, body in SPACES
            for teacher in TEACHERS
            if (challenge, teacher) != ("original", "random")  # which the screen has
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
            tuple(seeds),
            Schedule(steps, interval, INTERVAL, training_window=100_000),
        )
        for student, challenge, body, teacher, steps, interval, seeds in chosen
    ]
    return joined_plan(name, campaigns)


def evaluations(root: str) -> pd.DataFrame:
    """Returns mastered % of every evaluation of all runs, of all test tasks and of those of even index."""
    frames = analysis.load(root)
    rows = frames.evaluations
    halves = evaluation_measures(rows[rows["task_index"] % 2 == 0]).rename(
        columns={"mastered_percent": "mastered_half"}
    )
    found = frames.measured[["run_id", "step", "mastered_percent"]]
    found = found.merge(halves[["run_id", "step", "mastered_half"]], on=["run_id", "step"])
    runs = frames.cells.drop_duplicates("run_id")[["run_id", *CELL, "seed", "steps"]]
    table = runs.merge(found, on="run_id").drop(columns="run_id")
    return table.astype(dict.fromkeys(CELL, str) | {"steps": int}).sort_values(
        [*CELL, "steps", "seed", "step"]
    )


def areas(found: pd.DataFrame, until: int | None = None, column: str = "mastered_percent") -> pd.DataFrame:
    """Returns area and last three, in %, of each run that got to its budget, or to `until` steps."""
    rows = []
    for key, run in found.groupby([*CELL, "steps", "seed"], observed=True):
        end = until or key[-2]
        curve = run[run["step"] <= end].set_index("step")[column]
        if curve.index[-1] == end:
            area = np.trapezoid(curve, curve.index) / end
            rows.append((*key, area, curve.iloc[-3:].mean()))
    return pd.DataFrame(rows, columns=[*CELL, "steps", "seed", "area", "last_three"])


def every_second(found: pd.DataFrame) -> pd.DataFrame:
    """Returns the evaluations that today's schedule has."""
    return found[found["step"] % INTERVAL == 0]


def screened(found: pd.DataFrame) -> pd.DataFrame:
    """Returns mean and deviation of area and last three of the students of the screen, the best first."""
    runs = areas(every_second(found))
    runs = runs[(runs["challenge"] == "original") & (runs["teacher"] == "random")]
    runs = runs[runs["seed"].isin(SEEDS["screen"])]
    table = runs.groupby("student")[["area", "last_three"]].agg(["mean", "std", "count"])
    return table.sort_values(("area", "mean"), ascending=False)


def best_rollouts(found: pd.DataFrame) -> str:
    """Returns the student of `ROLLOUTS` with the largest mean area."""
    return str(screened(found).loc[list(ROLLOUTS), ("area", "mean")].idxmax())


def noise_of(runs: pd.DataFrame, measure: str) -> Estimate:
    """Returns signal to noise of the square roots of a measure of the runs of one student."""
    strata = [
        {teacher: np.sqrt(own[measure].to_numpy()) for teacher, own in space.groupby("teacher")}
        for _, space in runs.groupby(["challenge", "embodiment"])
    ]
    return signal_to_noise(strata)


def student_of_choice(found: pd.DataFrame) -> str:
    """Returns the student that the rule of part a chooses, whether or not it is good enough."""
    runs = areas(every_second(found))
    runs = runs[runs["seed"].isin(SEEDS["screen"])]
    best = list(screened(found).index[:2])
    ratios = {student: noise_of(runs[runs["student"] == student], "area").value for student in best}
    if min(ratios.values()) >= 0.9 * max(ratios.values()):
        means = runs[runs["student"].isin(best)].groupby("student")["area"].mean()
        return str(means.idxmax())
    return max(best, key=ratios.__getitem__)


def main() -> int:
    """Measures costs, prints tables, or runs what is missing."""
    options = parser(str(__doc__))
    options.add_argument("--parts", default=",".join(PARTS), help="in this order")
    options.add_argument("--csv", type=Path, default=MEASURED / "pilot.csv", help="file of all evaluations")
    options.add_argument("--costs", action="store_true", help="measure the costs of steps only")
    reads = "--costs" in sys.argv
    given = options.parse_args([*sys.argv[1:], *(["--results", ""] if reads else [])])
    if given.costs:
        table = costs()
        print(table.to_string())
        table.to_csv(MEASURED / "pilot_costs.csv", index=False)
        return 0
    found = pd.DataFrame()
    for part in given.parts.split(","):
        wanted = plan(part, found)
        print(part, describe(execute(wanted, given)), flush=True)
        found = evaluations(given.results)
        found.round(2).to_csv(given.csv, index=False)
        cells = analysis.load(given.results).cells
        if not set(cells[cells["status"] == "done"]["run_id"]).issuperset(run.run_id for run in wanted.runs):
            break  # the next call goes on
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

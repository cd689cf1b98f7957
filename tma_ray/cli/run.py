"""Commands that execute runs: `run`, `campaign`, `experiment` and others."""

import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from tma_ray.benchmark import EXPERIMENTS, find_experiment
from tma_ray.campaign import Campaign
from tma_ray.campaign.options import (
    EXECUTION_DEFAULTS,
    EXPERIMENT_DEFAULTS,
    CampaignOptions,
    ExecutionOptions,
    ExperimentOptions,
    RunOptions,
    campaign_defaults,
    names,
    parse_levels,
    parse_seeds,
    schedule_defaults,
)
from tma_ray.campaign.plan import QUICKSTART
from tma_ray.cli.common_options import Count, Json, Name, NewFile, Root
from tma_ray.cli.json_output import plan_record, print_json
from tma_ray.console.command_line import command, value
from tma_ray.console.exit_codes import FAILED
from tma_ray.console.types import named
from tma_ray.runs import Cell, Schedule
from tma_ray.support.interrupts import INTERRUPTED
from tma_ray.support.quantities import PROCESSES
from tma_ray.support.texts import counted
from tma_ray.testing import EPISODES

ExperimentName = Annotated[
    str,
    value(
        named("the name of an experiment"),
        "EXPERIMENT",
        help=f"one of {', '.join(experiment.name for experiment in EXPERIMENTS)}",
    ),
]


ONE_CELL = Campaign("campaign", cells=(Cell(),))
"""Default campaign of ``tma-ray campaign``."""


@command(defaults=schedule_defaults(Schedule()))
def run(*, options: RunOptions = RunOptions(), json: Json = False) -> int:
    """Train one student under one teacher, without Ray.

    The results go where those of campaigns go, and the same command continues a run that was interrupted.
    In Python, tma_ray's `train` does the same.

    Examples:
        tma-ray run --teacher alp_gmm --student ppo --steps 200k
        tma-ray run --student ppo:learning_rate=1e-4:hidden_units=64x64 --steps 200k
        tma-ray run --student ppo --space stump_height=0:0.3 --steps 200k
    """
    from tma_ray.campaign.script import SingleRunError, confirmed_single, run_single

    if not json:
        return run_single(options)
    from tma_ray.api import trained_run
    from tma_ray.results import policy_folder

    plan, placement = confirmed_single(options)
    try:
        trained = trained_run(plan, options.results, placement)
    except KeyboardInterrupt:
        return INTERRUPTED
    except SingleRunError as error:
        sys.stderr.write(f"{error}\n")
        return FAILED
    record = {
        "run_id": trained.run_id,
        "results": options.results,
        "mastered_area": trained.mastered_area,
        "last_three": trained.last_three,
        "curve": trained.curve.to_dict(orient="records"),
        "policy": policy_folder(trained.run_id),
    }
    print_json("run", record)
    return 0


@command(defaults=campaign_defaults(ONE_CELL))
def campaign(
    *,
    name: Name = "campaign",
    like: Annotated[str | None, value(named("a release"), "BASELINE")] = None,
    options: CampaignOptions = CampaignOptions(),
) -> int:
    """Run a matrix of cells with their seeds on Ray.

    These are all combinations of teachers, students, challenges, bodies and levels of expert knowledge. Runs
    that are done are not repeated: the same command continues.

    Args:
        name: name of the campaign in the results
        like: release whose cells, seeds and settings are repeated for --teachers; --challenges and --seeds
            narrow them (default: none)

    Examples:
        tma-ray campaign --teachers random,alp_gmm --students ppo --steps 500k
        tma-ray campaign --teachers alp_gmm:fit_every=100 --students ppo --steps 500k
        tma-ray campaign --teachers random,riac --seeds 2 --dry-run
        tma-ray campaign --like colleague --teachers random --results mine --dry-run
    """
    if like is None:
        from tma_ray.campaign.script import execute

        return execute(replace(ONE_CELL, name=name), options)
    from analysis.baselines import as_baseline
    from tma_ray.campaign.repeating import run_like

    baseline = as_baseline(like)
    released, core = (baseline.location, baseline.manifest.core) if baseline else (like, ())
    return run_like(name, released, core, options)


@command(defaults=EXPERIMENT_DEFAULTS)
def plan(
    experiment: ExperimentName, /, *, options: ExperimentOptions = ExperimentOptions(), json: Json = False
) -> int:
    """Print the size and the cost of an experiment of the benchmark.

    These are its cells, runs and steps, the hours, disk and memory that they take at the speed of this
    machine, and the differences that its seeds can detect.
    """
    from analysis.commands.rankings import show_detectable_differences
    from tma_ray.campaign.experiments import exclusions, plan_and_cost, show_plan
    from tma_ray.console.terminal import print_line
    from tma_ray.results import Store, check_usable

    chosen = find_experiment(experiment)
    check_usable(Store.open(options.results))
    plan, cost = plan_and_cost(chosen, options)
    if json:
        print_json("plan", plan_record(chosen.name, options.tier, plan, cost))
        return 0
    show_plan(f"{chosen.title}, tier {options.tier}", plan, cost)
    for reason in exclusions(chosen, options):
        print_line(reason)
    show_detectable_differences(plan.cell_rows, plan.budgets)
    return 0


@command(defaults=EXPERIMENT_DEFAULTS)
def experiment(experiment: ExperimentName, /, *, options: ExperimentOptions = ExperimentOptions()) -> int:
    """Run an experiment of the benchmark and print its results.

    Print its size and its cost, train what is missing on Ray, and print the ranking of the teachers, or the
    best points of a search. The same command continues.

    Examples:
        tma-ray experiment stump_tracks_challenges --tier smoke --results smoke
        tma-ray experiment full_benchmark --tier lite --results lite
        tma-ray experiment parkour --teachers random,alp_gmm --seeds 2 --dry-run
    """
    from analysis.commands.rankings import show_ranking, show_search
    from tma_ray.campaign.experiments import execute_experiment

    chosen = find_experiment(experiment)
    code = execute_experiment(chosen, options)
    if code or options.dry_run:
        return code
    if chosen.searches:
        show_search(options.results)
    else:
        show_ranking(options.results, chosen.read_at)
    return 0


@command(defaults=campaign_defaults(QUICKSTART))
def quickstart(*, options: CampaignOptions = CampaignOptions()) -> int:
    """Train a first small campaign and write its report.

    Compile the physics, train PPO under the teachers Random and ALP-GMM with three seeds each, and write a
    report: some minutes in all. The same command continues.
    """
    from analysis.pages.report import write_report
    from tma_ray.campaign.costs import estimate, measured_speeds
    from tma_ray.campaign.options import chosen_campaign
    from tma_ray.campaign.script import execute
    from tma_ray.results import Store, check_usable

    if options.dry_run:
        return execute(QUICKSTART, options)
    check_usable(Store.open(options.results))
    plan, config = chosen_campaign(QUICKSTART, options).plan(), options.config()
    stages, starts = ("compilation (once)", "training", "report"), [time.monotonic()]
    print("[1/3] Compiling the physics: about half a minute, once per machine")
    cost = estimate(plan, config, find_speeds=measured_speeds, nodes=options.nodes(config.device))
    starts.append(time.monotonic())
    print(f"[2/3] Training: {cost.summary()}; Ctrl-C stops, the same command continues")
    if code := execute(QUICKSTART, options):
        return code
    starts.append(time.monotonic())
    print("[3/3] Writing the report: a few seconds")
    page = write_report(options.results, Path("report") if "://" in str(options.results) else None)
    print("\nWhere the time went:")
    for stage, start, end in zip(stages, starts, (*starts[1:], time.monotonic()), strict=True):
        seconds = round(end - start)
        print(f"  {stage:{len(stages[0])}}  {seconds // 60} min {seconds % 60:02} s")
    print(f"Next: open {page} in a browser, then type\n  tma-ray ranking {options.results}")
    return 0


@command(defaults=EXECUTION_DEFAULTS)
def rerun(
    root: Root,
    /,
    *run: Annotated[str, value(named("the ID of a run"), "RUN")],
    failed: bool = False,
    options: ExecutionOptions = ExecutionOptions(),
) -> int:
    """Run failed or unfinished runs of a results root again.

    They continue from their checkpoints where they have some.

    Args:
        root: results root of the runs
        run: IDs of runs, or unambiguous beginnings of them
        failed: choose all runs that failed
    """
    from tma_ray.campaign.repeating import rerun_plan
    from tma_ray.campaign.script import run_plan

    return run_plan(rerun_plan(str(root), run, failed=failed), str(root), options)


@command()
def stop(root: Root, /) -> int:
    """Stop the campaign on a results root; its runs leave checkpoints.

    The command that started it continues them.

    Args:
        root: results root of the campaign
    """
    from tma_ray.results import Store, ask_to_stop

    print(
        f"asked {ask_to_stop(Store.open(root))} to stop; its runs leave checkpoints and it ends. "
        f"Next: 'tma-ray status {root}' shows when; the command that started it continues it"
    )
    return 0


@command()
def simulate(
    *,
    teachers: Annotated[tuple[str, ...], value(names, "NAME,...")] = (),
    challenges: Annotated[tuple[str, ...], value(names, "NAME,...")] = (),
    expert_knowledge: Annotated[tuple[str, ...], value(names, "LEVEL,...")] = (),
    seeds: Annotated[tuple[int, ...], value(parse_seeds, "SEEDS")] = tuple(range(10)),
    episodes: Count = EPISODES,
    jobs: Annotated[int, value(PROCESSES, "N")] = 1,
    output: NewFile | None = None,
    results: Root | None = None,
) -> int:
    """Compare teachers on simulated students, without physics.

    This takes minutes instead of days.

    Args:
        teachers: teachers, with hyper-parameters if wanted, as in alp_gmm:fit_every=100,riac (default: all)
        challenges: simulated challenges (default: all six)
        expert_knowledge: levels offered (default: none,low,high)
        seeds: number of seeds (4), or given ones: a range (8-11) or a list (0,5) (default: 10)
        episodes: number of episodes of each run
        jobs: number of processes
        output: CSV or Parquet file with a row a run (default: none)
        results: results root to write each run to as it ends; runs that it has are not played again (default:
            none)
    """
    from rich.progress import track

    from analysis.commands import simulated
    from tma_ray.campaign.simulated import SimulatedRoot
    from tma_ray.console.terminal import terminal
    from tma_ray.tasks import KnowledgeLevel
    from tma_ray.teachers import TEACHERS, canonical_teacher
    from tma_ray.testing import SIMULATED_CHALLENGES, find_simulated_challenge, matrix

    if output:
        simulated.check_file(output)
    challenge_names = challenges or [challenge.name for challenge in SIMULATED_CHALLENGES]
    cells = matrix.cells_of(
        [canonical_teacher(name) for name in teachers or TEACHERS.names()],
        [find_simulated_challenge(name) for name in challenge_names],
        parse_levels(expert_knowledge or tuple(KnowledgeLevel)),
    )
    planned = cells, seeds, episodes
    root = SimulatedRoot(results, *planned) if results else None
    played = root.kept() if root else []
    total = matrix.run_count(cells, seeds) - len(played)
    runs = matrix.run_cells(*planned, jobs, tuple(played))
    try:
        with closing(runs):
            for run in track(runs, "simulating", total, console=terminal(stderr=True)):
                if root:
                    root.add(run)
                played.append(run)
    except matrix.ProcessLostError as error:
        hint = "the same command plays the others" if root else "with --results they would be kept"
        sys.stderr.write(f"tma-ray: {error}; done so far: {counted(len(played), 'run')}; {hint}\n")
        return FAILED
    frame = matrix.tabulate(cells, played)
    if output:
        simulated.write(frame, output)
    simulated.show(frame)
    return 0

"""The command `tma-ray`. Heavy parts are imported by the commands that need them."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path

from tma_ray import __version__

REFUSED = 2

KINDS = ("teachers", "students", "environments", "embodiments", "challenges", "test-sets")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code."""
    from tma_ray.results import RootInUseError

    options = _parser().parse_args(arguments)
    sys.path.insert(0, str(Path.cwd()))  # so that module:Name finds the user's own file
    command: Callable[[argparse.Namespace], int] = options.command
    warnings.showwarning = _show_warning
    try:
        return command(options)
    except (ValueError, ConnectionError, RootInUseError) as error:
        sys.stderr.write(f"tma-ray: {error}\n")
        return REFUSED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="tma-ray", description="Compare curriculum learning teachers.")
    parser.add_argument("--version", action="version", version=f"tma_ray {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_run(commands.add_parser("run", help="one run in this process, without Ray"))
    _add_campaign(commands.add_parser("campaign", help="a matrix of runs on Ray"))
    _add_plan(commands.add_parser("plan", help="what an experiment of the benchmark comes to and costs"))
    _add_simulate(commands.add_parser("simulate", help="teachers of simulated students, without physics"))
    _add_render(commands.add_parser("render", help="an episode as a video or a picture"))
    status = commands.add_parser("status", help="how far the campaigns of a results root are")
    status.add_argument("root", metavar="ROOT")
    status.add_argument("--cells", action="store_true", help="a line for every cell")
    status.add_argument("--watch", action="store_true", help="again every few seconds, until Ctrl-C")
    status.set_defaults(command=_status)
    stop = commands.add_parser("stop", help="ask the campaign on a results root to leave with checkpoints")
    stop.add_argument("root", metavar="ROOT")
    stop.set_defaults(command=_stop)
    logs = commands.add_parser("logs", help="what a run went through, and why it failed")
    logs.add_argument("run", metavar="RUN", help="its id, or an unambiguous beginning of it")
    logs.add_argument("--results", default="results", metavar="ROOT", help="(%(default)s)")
    logs.set_defaults(command=_logs)
    _add_rerun(commands.add_parser("rerun", help="runs of a results root again that failed"))
    report = commands.add_parser("report", help="write the report of a results root")
    report.add_argument("root", metavar="ROOT")
    report.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="default: ROOT/report")
    report.set_defaults(command=_report)
    tensorboard = commands.add_parser("tensorboard", help="scalars of a results root as event files")
    tensorboard.add_argument("root", metavar="ROOT")
    tensorboard.add_argument("folder", metavar="FOLDER", help="for TensorBoard's --logdir")
    tensorboard.add_argument("--watch", action="store_true", help="follow the campaign, until Ctrl-C")
    tensorboard.set_defaults(command=_tensorboard)
    search = commands.add_parser("search", help="what a search for hyper-parameters found")
    search.add_argument("root", metavar="ROOT")
    search.set_defaults(command=_search)
    doctor = commands.add_parser("doctor", help="what this machine offers a campaign")
    doctor.add_argument("--results", type=Path, default=Path("results"), metavar="FOLDER")
    doctor.set_defaults(command=_doctor)
    listing = commands.add_parser("list", help="what can be named: teachers, students, ...")
    listing.add_argument("kind", nargs="?", choices=KINDS)
    listing.set_defaults(command=_list)
    return parser


def _add_run(parser: argparse.ArgumentParser) -> None:
    from tma_ray.campaign.options import whole_number

    parser.add_argument("--environment", default="stump_tracks", metavar="NAME")
    parser.add_argument("--challenge", default="original", metavar="NAME")
    parser.add_argument("--embodiment", default="classic_bipedal", metavar="NAME")
    parser.add_argument("--student", default="sac", metavar="NAME")
    parser.add_argument("--teacher", default="random", metavar="NAME")
    parser.add_argument("--expert-knowledge", default="none", metavar="LEVEL")
    parser.add_argument("--test-set", metavar="NAME|CSV")
    parser.add_argument("--seed", type=int, default=0)
    for flag in ("steps", "evaluation-interval", "probe-interval", "training-window"):
        parser.add_argument(f"--{flag}", type=whole_number, metavar="N")
    parser.add_argument("--results", default="results", metavar="ROOT")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--checkpoint-seconds", type=float, default=600.0, metavar="S")
    parser.set_defaults(command=_run)


def _add_campaign(parser: argparse.ArgumentParser) -> None:
    from tma_ray.campaign.options import add_options

    parser.add_argument("--name", default="campaign", help="of the campaign in the results (%(default)s)")
    add_options(parser)
    parser.set_defaults(command=_campaign)


def _add_plan(parser: argparse.ArgumentParser) -> None:
    from tma_ray.benchmark import EXPERIMENTS
    from tma_ray.campaign.experiments import add_experiment_options

    known = ", ".join(experiment.name for experiment in EXPERIMENTS)
    parser.add_argument("experiment", metavar="EXPERIMENT", help=known)
    add_experiment_options(parser)
    parser.set_defaults(command=_plan)


def _add_rerun(parser: argparse.ArgumentParser) -> None:
    from tma_ray.campaign.options import add_execution_options

    parser.add_argument("root", metavar="ROOT")
    parser.add_argument("runs", nargs="*", metavar="RUN", help="ids, or unambiguous beginnings of them")
    parser.add_argument("--failed", action="store_true", help="all that failed")
    add_execution_options(parser)
    parser.set_defaults(command=_rerun)


def _add_simulate(parser: argparse.ArgumentParser) -> None:
    from tma_ray.campaign.options import names, parse_seeds, whole_number
    from tma_ray.tasks import KnowledgeLevel

    parser.add_argument("--teachers", type=names, metavar="A,B", help="default: all of the catalogue")
    parser.add_argument("--challenges", type=names, metavar="A,B", help="default: all six")
    parser.add_argument("--expert-knowledge", type=names, metavar="A,B", default=tuple(KnowledgeLevel))
    parser.add_argument("--seeds", type=parse_seeds, metavar="N|A-B|A,B", default=tuple(range(10)))
    parser.add_argument("--episodes", type=whole_number, metavar="N", help="default: 10,000")
    parser.add_argument("--jobs", type=whole_number, metavar="N", default=1, help="processes (%(default)s)")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.csv", help="or FILE.parquet: a row a run")
    parser.set_defaults(command=_simulate)


def _add_render(parser: argparse.ArgumentParser) -> None:
    from tma_ray.campaign.options import whole_number

    parser.add_argument("--environment", metavar="NAME", help="default: the run's, else stump_tracks")
    parser.add_argument("--embodiment", metavar="NAME", help="default: the run's, else classic_bipedal")
    parser.add_argument("--task", metavar="V,V|NAME=V|random", help="default: the middle of the task space")
    parser.add_argument(
        "--policy", default="random", metavar="RUN|FOLDER|random|zero", help="who acts (%(default)s)"
    )
    parser.add_argument("--results", default="results", metavar="ROOT", help="where RUN is (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=whole_number, default=1000, metavar="N", help="at most (%(default)s)")
    parser.add_argument(
        "--every", type=whole_number, default=2, metavar="N", help="steps a frame (%(default)s)"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.mp4|.gif|.png")
    parser.set_defaults(command=_render)


def _run(options: argparse.Namespace) -> int:
    from tma_ray.campaign.single import run_single

    return run_single(options)


def _campaign(options: argparse.Namespace) -> int:
    from tma_ray.campaign.campaign import Campaign
    from tma_ray.campaign.script import execute
    from tma_ray.runs import Cell

    return execute(Campaign(options.name, cells=(Cell(),)), options)


def _plan(options: argparse.Namespace) -> int:
    from analysis.planning import show_detectable_differences
    from tma_ray.benchmark import find_experiment
    from tma_ray.campaign.planning import show_plan

    show_detectable_differences(show_plan(find_experiment(options.experiment), options).cell_rows)
    return 0


def _simulate(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import track

    from analysis import simulated
    from tma_ray.campaign.options import parse_levels
    from tma_ray.teachers import TEACHERS
    from tma_ray.testing import EPISODES, SIMULATED_CHALLENGES, find_simulated_challenge, matrix

    if options.output:
        simulated.check_file(options.output)
    names = options.challenges or [challenge.name for challenge in SIMULATED_CHALLENGES]
    challenges = [find_simulated_challenge(name) for name in names]
    teachers, levels = options.teachers or TEACHERS.names(), parse_levels(options.expert_knowledge)
    cells = matrix.cells_of(teachers, challenges, levels)
    runs = matrix.run_cells(cells, options.seeds, options.episodes or EPISODES, options.jobs)
    total = matrix.run_count(cells, options.seeds)
    frame = matrix.tabulate(cells, track(runs, "simulating", total, console=Console(stderr=True)))
    if options.output:
        simulated.write(frame, options.output)
    simulated.show(frame)
    return 0


def _render(options: argparse.Namespace) -> int:
    from tma_ray.runs.rendering import Scenario, render

    given = {name: value for name, value in vars(options).items() if name in Scenario.__dataclass_fields__}
    outcome = render(Scenario(**given), options.output)
    success = "mastered" if outcome.success else "not mastered"
    end = f"ended after {outcome.steps}" if outcome.ended else f"left after {outcome.steps}"
    print(f"{options.output}: {end} steps, return {outcome.episodic_return:.1f}, {success}")
    return 0


def _status(options: argparse.Namespace) -> int:
    from tma_ray.campaign.status import show, watch

    if options.watch:
        with suppress(KeyboardInterrupt):
            watch(options.root, options.cells)
    else:
        show(options.root, options.cells)
    return 0


def _stop(options: argparse.Namespace) -> int:
    from tma_ray.results import Store, ask_to_stop

    print(f"asked {ask_to_stop(Store.open(options.root))} to stop; its runs leave checkpoints and it ends")
    return 0


def _logs(options: argparse.Namespace) -> int:
    from tma_ray.campaign.history import show

    show(options.run, options.results)
    return 0


def _rerun(options: argparse.Namespace) -> int:
    from tma_ray.campaign.rerun import rerun

    return rerun(options)


def _report(options: argparse.Namespace) -> int:
    from analysis.report import write_report

    print(write_report(options.root, options.output))
    return 0


def _search(options: argparse.Namespace) -> int:
    from analysis.search import show_search

    show_search(options.root)
    return 0


def _tensorboard(options: argparse.Namespace) -> int:
    from analysis.tensorboard import EventFolder, watch

    with closing(EventFolder(options.root, options.folder)) as events:
        print(f"runs with news: {events.update()}; to look at them: tensorboard --logdir {options.folder}")
        with suppress(KeyboardInterrupt):
            for count in watch(events) if options.watch else ():
                print(f"runs with news: {count}", flush=True)
    return 0


def _doctor(options: argparse.Namespace) -> int:
    from tma_ray.campaign.doctor import show

    show(options.results)
    return 0


def _list(options: argparse.Namespace) -> int:
    for kind in [options.kind] if options.kind else KINDS:
        print(f"{kind}:", *_names(kind), sep="\n  ")
    return 0


def _names(kind: str) -> Sequence[str]:
    from tma_ray.benchmark import CHALLENGES, shipped_test_sets
    from tma_ray.embodiments import embodiment_names
    from tma_ray.envs import ENVIRONMENTS
    from tma_ray.students import STUDENTS
    from tma_ray.teachers import TEACHERS

    names: dict[str, Callable[[], Sequence[str]]] = {
        "teachers": TEACHERS.names,
        "students": STUDENTS.names,
        "environments": ENVIRONMENTS.names,
        "embodiments": embodiment_names,
        "challenges": lambda: [f"{challenge.name} ({challenge.environment})" for challenge in CHALLENGES],
        "test-sets": shipped_test_sets,
    }
    return names[kind]()


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    sys.stderr.write(f"tma-ray: warning: {message}\n")


if __name__ == "__main__":
    sys.exit(main())

"""Commands that show what has been run."""

from __future__ import annotations

import argparse
from contextlib import closing
from typing import TYPE_CHECKING, Any

from tma_ray.cli.json_output import add_json_option, print_json
from tma_ray.cli.playing import TASK, add_episode, add_scene
from tma_ray.cli.records import any_failed, claims_record, ranking_record, status_record
from tma_ray.cli.reporting import add_report_commands
from tma_ray.cli.sources import add_measure, add_sources, chosen_sources
from tma_ray.command_line import CommandParser
from tma_ray.commands.exits import FAILED
from tma_ray.commands.places import folder, new_file, root
from tma_ray.commands.quantities import SHARE
from tma_ray.commands.texts import named

if TYPE_CHECKING:
    from analysis.tracking.points import Tracker


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    commands.add_parser(
        "status",
        help="print the progress of the campaigns of a results root",
        description="Print the progress of the campaigns of a results root, their speed, and why runs "
        "failed. It may be called from any machine that sees the root. The exit code is 1 if runs have "
        "failed.",
        populate=_add_status,
    )
    commands.add_parser(
        "logs",
        help="print the history of a run, with the error that ended it",
        description="Print the attempts at a run, their outcomes, and the traceback of the error that "
        "ended it.",
        populate=_add_logs,
    )
    add_report_commands(commands)
    _add_findings(commands)


def _add_findings(commands: Any) -> None:
    commands.add_parser(
        "ranking",
        help="rank the teachers on each challenge by mastered tasks",
        description="Rank the teachers of a results root on each challenge by mastered test tasks, with "
        "tests against Random.",
        populate=_add_ranking,
        examples=(
            "tma-ray ranking results",
            "tma-ray ranking results --baseline colleague",
            "tma-ray ranking results --share 0.5",
            "tma-ray ranking results --json",
        ),
    )
    commands.add_parser(
        "claims",
        help="check the paper's claims against a results root",
        description="Check each of the paper's claims against a results root.",
        populate=_add_claims,
    )
    commands.add_parser(
        "search",
        help="print the best hyper-parameters of a search",
        description="Print the best hyper-parameters of the searches of a results root, beside the "
        "paper's choice.",
        populate=_add_search,
    )
    commands.add_parser(
        "tensorboard",
        help="export the scalars of a results root as event files",
        description="Export the scalars of a results root as event files for TensorBoard.",
        populate=_add_tensorboard,
    )
    commands.add_parser(
        "wandb",
        help="send the scalars of a results root to Weights & Biases",
        description="Send the scalars of a results root to a project of Weights & Biases, each run under "
        "its own ID, in groups of runs that differ in their seed alone. The same command continues.",
        populate=_add_wandb,
        examples=("tma-ray wandb results --project tma_ray --offline",),
    )
    commands.add_parser(
        "render",
        help="render an episode as a video or a picture",
        description="Render an episode of a saved policy, of random actions or of none as a video or a "
        "picture.",
        populate=_add_render,
    )


def _add_status(parser: CommandParser) -> None:

    parser.add_argument("root", type=root, metavar="ROOT", help="results root")
    parser.add_argument("--cells", action="store_true", help="print a line for every cell")
    parser.add_argument("--watch", action="store_true", help="print it again every few seconds, until Ctrl-C")
    add_json_option(parser)
    parser.set_defaults(command=_status)


def _add_logs(parser: CommandParser) -> None:
    parser.add_argument(
        "run",
        type=named("the ID of a run"),
        metavar="RUN",
        help="ID of a run, or an unambiguous beginning of it",
    )
    parser.add_argument(
        "--results", type=root, default="results", metavar="ROOT", help="results root of the run"
    )
    parser.set_defaults(command=_logs)


def _add_ranking(parser: CommandParser) -> None:

    add_sources(parser)
    parser.add_argument(
        "--share", type=SHARE, default=1.0, metavar="X", help="share of the budget after which runs are read"
    )
    add_measure(parser)
    add_json_option(parser)
    parser.set_defaults(command=_ranking)


def _add_claims(parser: CommandParser) -> None:

    add_sources(parser)
    parser.add_argument("--details", action="store_true", help="print every statement, with its numbers")
    add_json_option(parser)
    parser.set_defaults(command=_claims)


def _add_search(parser: CommandParser) -> None:
    parser.add_argument("root", type=root, metavar="ROOT", help="results root")
    parser.set_defaults(command=_search)


def _add_tensorboard(parser: CommandParser) -> None:
    parser.add_argument("root", type=root, metavar="ROOT", help="results root")
    parser.add_argument(
        "folder", type=folder, metavar="FOLDER", help="folder to write to, for TensorBoard's --logdir"
    )
    parser.add_argument("--watch", action="store_true", help="follow the campaign, until Ctrl-C")
    parser.set_defaults(command=_tensorboard)


def _add_wandb(parser: CommandParser) -> None:
    parser.add_argument("root", type=root, metavar="ROOT", help="results root")
    parser.add_argument(
        "--project", type=named("a project"), default="tma_ray", metavar="NAME", help="project to send to"
    )
    parser.add_argument(
        "--entity",
        type=named("a user or team"),
        metavar="NAME",
        help="user or team that has the project (default: the one logged in)",
    )
    parser.add_argument(
        "--folder", type=folder, default="wandb", metavar="FOLDER", help="where the library writes"
    )
    parser.add_argument(
        "--offline", action="store_true", help="write to the folder only; 'wandb sync' sends it later"
    )
    parser.add_argument("--watch", action="store_true", help="follow the campaign, until Ctrl-C")
    parser.set_defaults(command=_wandb)


def _add_render(parser: CommandParser) -> None:
    add_scene(parser)
    parser.add_argument(
        "--task", type=named("a task"), metavar="TASK", help=f"{TASK} (default: the middle of the task space)"
    )
    add_episode(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=new_file,
        required=True,
        metavar="FILE",
        help="video (.mp4, .gif) or picture (.png)",
    )
    parser.set_defaults(command=_render)


def _render(options: argparse.Namespace) -> int:
    from tma_ray.viewing.rendering import EpisodeSettings, render

    given = {
        name: value for name, value in vars(options).items() if name in EpisodeSettings.__dataclass_fields__
    }
    episode = render(EpisodeSettings(**given), options.output)
    success = "mastered" if episode.success else "not mastered"
    end = f"ended after {episode.steps}" if episode.ended else f"left after {episode.steps}"
    print(f"{options.output}: {end} steps, return {episode.episodic_return:.1f}, {success}")
    return 0


def _status(options: argparse.Namespace) -> int:
    if options.json:
        record = status_record(options.root)
        print_json("status", record)
        return FAILED if any_failed(record) else 0
    from tma_ray.campaign.monitor import show_status, watch_status

    if options.watch:
        watch_status(options.root, options.cells)
    return FAILED if show_status(options.root, options.cells) else 0


def _logs(options: argparse.Namespace) -> int:
    from tma_ray.campaign.monitor import show_history

    show_history(options.run, options.results)
    return 0


def _ranking(options: argparse.Namespace) -> int:
    if options.json:
        print_json("ranking", ranking_record(chosen_sources(options), options.share, options.measure))
        return 0
    from analysis.commands.ranking import show_ranking

    show_ranking(chosen_sources(options), options.share, measure=options.measure)
    return 0


def _claims(options: argparse.Namespace) -> int:
    if options.json:
        print_json("claims", claims_record(chosen_sources(options)))
        return 0
    from analysis.commands.claims import show_claims

    show_claims(chosen_sources(options), options.details)
    return 0


def _search(options: argparse.Namespace) -> int:
    from analysis.commands.search import show_search

    show_search(options.root)
    return 0


def _tensorboard(options: argparse.Namespace) -> int:
    from analysis.tracking.event_folder import EventFolder

    with closing(EventFolder(options.root, options.folder)) as events:
        return _track(events, f"; to look at them: tensorboard --logdir {options.folder}", options.watch)


def _wandb(options: argparse.Namespace) -> int:
    from analysis.tracking.wandb_project import WandbProject

    place = options.root, options.project, options.entity, options.folder
    later = f"; to send them: wandb sync {options.folder}/wandb/offline-run-*" if options.offline else ""
    return _track(WandbProject(*place, offline=options.offline), later, options.watch)


def _track(tracker: Tracker, hint: str, follow: bool) -> int:
    """Hands over what has been published, once or until Ctrl-C."""
    from analysis.tracking.points import watch

    print(f"runs with news: {tracker.update()}{hint}", flush=True)
    for count in watch(tracker) if follow else ():
        print(f"runs with news: {count}", flush=True)
    return 0

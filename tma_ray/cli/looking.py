"""Commands that look at what has been run."""

from __future__ import annotations

import argparse
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from tma_ray.cli.reporting import add_report_command


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    _add_status(commands.add_parser("status", help="how far the campaigns of a results root are"))
    _add_logs(commands.add_parser("logs", help="what a run went through, and why it failed"))
    add_report_command(commands)
    _add_ranking(commands.add_parser("ranking", help="who masters most on each challenge"))
    _add_claims(commands.add_parser("claims", help="which of the paper's claims hold in a results root"))
    _add_search(commands.add_parser("search", help="what a search for hyper-parameters found"))
    _add_tensorboard(commands.add_parser("tensorboard", help="scalars of a results root as event files"))
    _add_render(commands.add_parser("render", help="an episode as a video or a picture"))


def _add_status(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", metavar="ROOT")
    parser.add_argument("--cells", action="store_true", help="a line for every cell")
    parser.add_argument("--watch", action="store_true", help="again every few seconds, until Ctrl-C")
    parser.set_defaults(command=_status)


def _add_logs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", metavar="RUN", help="its id, or an unambiguous beginning of it")
    parser.add_argument("--results", default="results", metavar="ROOT", help="(%(default)s)")
    parser.set_defaults(command=_logs)


def _add_ranking(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", metavar="ROOT")
    parser.add_argument("--share", type=float, default=1.0, metavar="X", help="of the budget (%(default)s)")
    parser.set_defaults(command=_ranking)


def _add_claims(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", metavar="ROOT")
    parser.add_argument("--details", action="store_true", help="every statement, with its numbers")
    parser.set_defaults(command=_claims)


def _add_search(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", metavar="ROOT")
    parser.set_defaults(command=_search)


def _add_tensorboard(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", metavar="ROOT")
    parser.add_argument("folder", metavar="FOLDER", help="for TensorBoard's --logdir")
    parser.add_argument("--watch", action="store_true", help="follow the campaign, until Ctrl-C")
    parser.set_defaults(command=_tensorboard)


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
    from tma_ray.campaign.monitor.status import show, watch

    if options.watch:
        with suppress(KeyboardInterrupt):
            watch(options.root, options.cells)
    else:
        show(options.root, options.cells)
    return 0


def _logs(options: argparse.Namespace) -> int:
    from tma_ray.campaign.monitor.history import show

    show(options.run, options.results)
    return 0


def _ranking(options: argparse.Namespace) -> int:
    from analysis.ranking import show_ranking

    show_ranking(options.root, options.share)
    return 0


def _claims(options: argparse.Namespace) -> int:
    from analysis.claims_view import show_claims

    show_claims(options.root, options.details)
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

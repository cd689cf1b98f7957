"""The commands that write the report of a results root and print the leaderboard of releases."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tma_ray.cli.sources import add_sources, chosen_sources
from tma_ray.command_line import CommandParser
from tma_ray.commands.places import expanded, folder
from tma_ray.commands.texts import named

if TYPE_CHECKING:
    from analysis.pages.videos import Video, WantedVideo

RELOAD_SECONDS, LOOK_SECONDS = 30, 10.0
"""Time after which the open page of a report that is watched reads itself again, and between two looks, s."""

LONGEST = 2000
"""Steps after which a video ends, if its episode has not: the limit of the benchmark's worlds."""

EVERY = {".mp4": 3, ".gif": 8}
"""Steps from one frame to the next; a .gif takes far more room."""


def add_report_commands(commands: Any) -> None:
    """Adds ``report`` and ``leaderboard`` to the subparsers `commands`."""
    commands.add_parser(
        "report",
        help="write the report of a results root",
        description="Write the report of a results root: a page with tables, tests, learning curves and "
        "curricula.",
        populate=_add_report,
        examples=(
            "tma-ray report results",
            "tma-ray report results colleague",
            "tma-ray report results --output pages --latex",
            "tma-ray report results --watch",
        ),
    )
    commands.add_parser(
        "leaderboard",
        help="print ranks, results and cost of the teachers of releases",
        description="Print the leaderboard of releases: the ranks of teachers over all challenges with what "
        "of them is certain, their results on each challenge with intervals, and what their runs cost.",
        populate=_add_leaderboard,
        examples=("tma-ray leaderboard", "tma-ray leaderboard colleague"),
    )


def _add_report(parser: CommandParser) -> None:
    add_sources(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=folder,
        metavar="FOLDER",
        help="folder to write to (default: report in the first ROOT)",
    )
    parser.add_argument(
        "--videos", action="store_true", help="embed videos of the best and the worst seed of every teacher"
    )
    parser.add_argument("--latex", action="store_true", help="also write LaTeX, with all tables and figures")
    parser.add_argument(
        "--watch",
        action="store_true",
        help="write it anew when runs have published more, until Ctrl-C; the open page follows",
    )
    parser.set_defaults(command=_report)


def _report(options: argparse.Namespace) -> int:
    from analysis.pages.report import report_folder, write_report

    sources = chosen_sources(options)
    folder = report_folder(sources, options.output)
    videos = list(_videos(sources, folder / "videos")) if options.videos else []
    print(write_report(sources, folder, videos, RELOAD_SECONDS if options.watch else 0), flush=True)
    if options.latex:
        from analysis.commands.latex import write_latex  # matplotlib, which takes a while to import

        latex = write_latex(sources, folder / "latex")
        for warning in latex.warnings:
            sys.stderr.write(f"tma-ray: warning: {warning}\n")
        print(latex.document)
    for _ in changes(sources) if options.watch else ():
        write_report(sources, folder, videos, RELOAD_SECONDS)
    return 0


def changes(sources: Sequence[str], seconds: float = LOOK_SECONDS) -> Iterator[None]:
    """Yields whenever runs of results roots have published more; never ends.

    Args:
        sources: results roots, or baselines, which do not change.
        seconds: time between two looks, s.
    """
    from tma_ray.results import MANIFESTS, Store

    stores = [Store.open(each) for each in sources if "://" in each or expanded(each).exists()]
    seen = [store.stamps(MANIFESTS) for store in stores]
    while True:
        time.sleep(seconds)
        found = [store.stamps(MANIFESTS) for store in stores]
        if found != seen:
            seen = found
            yield


def _videos(sources: Sequence[str], folder: Path) -> Iterator[Video]:
    """Renders what the report wants to show; what cannot be rendered is named and left out."""
    from analysis.baselines.catalogue import read
    from analysis.comparisons.measured import measure
    from analysis.pages.videos import wanted_videos

    frames = read(sources)
    for wanted in wanted_videos(frames, measure(frames)):
        folder.mkdir(parents=True, exist_ok=True)
        try:
            yield _video(str(frames.results_of(wanted.run_id).store), wanted, folder)
        except ValueError as error:  # no policy was saved, or its world cannot be drawn
            sys.stderr.write(f"tma-ray: warning: no video of {wanted.run_id}: {error}\n")


def _video(root: str, wanted: WantedVideo, folder: Path) -> Video:
    from importlib.util import find_spec

    from analysis.pages.videos import Video
    from tma_ray.runs.saved_policies import find_policy
    from tma_ray.runs.spec import evaluation_seeds
    from tma_ray.viewing.rendering import EpisodeSettings, render

    ending = ".mp4" if find_spec("av") else ".gif"
    file = folder / f"{wanted.name}{ending}"
    world = evaluation_seeds(find_policy(wanted.run_id, root).spec.test_set)[wanted.task_index]
    settings = EpisodeSettings(
        policy=wanted.run_id, results=root, task=wanted.task, seed=world, steps=LONGEST, every=EVERY[ending]
    )
    return Video(wanted, file, render(settings, file).episodic_return)


def _add_leaderboard(parser: CommandParser) -> None:
    parser.add_argument(
        "releases",
        nargs="*",
        type=named("a baseline"),
        metavar="BASELINE",
        help="releases, or folders or addresses of results (default: those that ship with runs)",
    )
    parser.set_defaults(command=_leaderboard)


def _leaderboard(options: argparse.Namespace) -> int:
    from analysis.commands.leaderboard import show_leaderboards

    show_leaderboards(options.releases)
    return 0

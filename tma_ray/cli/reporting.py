"""Commands that report on results: pages, tables, figures, rankings, and exports to trackers."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tma_ray.cli import common_options as options
from tma_ray.cli.json_output import claims_record, print_json, ranking_record
from tma_ray.console.command_line import choice, command, value, values
from tma_ray.console.types import named
from tma_ray.support.quantities import SHARE, expanded

if TYPE_CHECKING:
    from analysis.pages.report import Video
    from analysis.tracking.points import Tracker

RELOAD_SECONDS, POLL_SECONDS = 30, 10.0
"""Intervals at which the open page of a watched report reloads, and at which results are polled, s."""

MAX_VIDEO_STEPS = 2000  # longest video in steps: the step limit of the benchmark's worlds
FRAME_STEPS = {".mp4": 3, ".gif": 8}  # environment steps per frame


@command()
def report(
    *root: options.Roots,
    baseline: options.Baselines = (),
    output: options.Output | None = None,
    videos: bool = False,
    latex: bool = False,
    watch: bool = False,
) -> int:
    """Write the report of a results root.

    It is a page with tables, tests, learning curves and curricula.

    Args:
        root: results root, or the name of a baseline with runs; several are read as one
        output: folder to write to (default: report in the first ROOT)
        videos: embed videos of the best and the worst seed of every teacher
        latex: write LaTeX, too, with all tables and figures
        watch: write it again when runs have published more, until Ctrl-C; the open page follows

    Examples:
        tma-ray report results
        tma-ray report results colleague
        tma-ray report results --output pages --latex
        tma-ray report results --watch
    """
    from analysis.pages.report import report_folder, write_report

    sources = (*root, *baseline)
    folder = report_folder(sources, output)
    shown = list(_videos(sources, folder / "videos")) if videos else []
    print(write_report(sources, folder, shown, RELOAD_SECONDS if watch else 0), flush=True)
    if latex:
        from analysis.commands.paper import write_latex  # imported late, since it imports matplotlib

        written = write_latex(sources, folder / "latex")
        _warn(written.warnings)
        print(*written.files)
    for _ in changes(sources) if watch else ():
        write_report(sources, folder, shown, RELOAD_SECONDS)
    return 0


def changes(sources: Sequence[str | Path], seconds: float = POLL_SECONDS) -> Iterator[None]:
    """Yield each time a run in one of `sources` publishes new results; never ends.

    Args:
        sources: results roots, or baselines, which do not change.
        seconds: polling interval, s.
    """
    from tma_ray.results import MANIFESTS, Store

    stores = [Store.open(root) for root in sources if "://" in str(root) or expanded(root).exists()]
    before = [store.stamps(MANIFESTS) for store in stores]
    while True:
        time.sleep(seconds)
        stamps = [store.stamps(MANIFESTS) for store in stores]
        if stamps != before:
            before = stamps
            yield


def _videos(sources: Sequence[str | Path], folder: Path) -> Iterator[Video]:
    """Yield the rendered videos of a report, and print warnings about those that cannot be rendered."""
    from importlib.util import find_spec

    from analysis.baselines.catalogue import read
    from analysis.comparisons.comparison import Measurements
    from analysis.pages.report import Video, video_requests
    from tma_ray.runs.checkpoints import find_policy
    from tma_ray.runs.spec import evaluation_seeds
    from tma_ray.viewing.rendering import EpisodeSettings, render

    frames, suffix = read(sources), ".mp4" if find_spec("av") else ".gif"
    for request in video_requests(Measurements(frames)):
        folder.mkdir(parents=True, exist_ok=True)
        run, task, file = request.run_id, request.task, folder / f"{request.name}{suffix}"
        root = str(frames.results_of(run).store)
        try:
            seed = evaluation_seeds(find_policy(run, root).spec.test_set)[request.task_index]
            settings = EpisodeSettings(
                policy=run,
                results=root,
                task=task,
                seed=seed,
                steps=MAX_VIDEO_STEPS,
                every=FRAME_STEPS[suffix],
            )
            yield Video(request, file, render(settings, file).episodic_return)
        except ValueError as error:  # there is no policy, or the world cannot be drawn
            _warn([f"no video of {run}: {error}"])


@command()
def leaderboard(
    *baseline: options.Baseline,
    challenges: bool = False,
    subsets: bool = False,
    trials: bool = False,
    explain: bool = False,
) -> int:
    """Print the best teachers of releases, sooner and in the end.

    These are the teachers' means over all challenges, their differences to Random and their ranks, with what
    of them is certain.

    Args:
        baseline: releases, or folders or addresses of results (default: those that ship with runs)
        challenges: print the results on each challenge, too
        subsets: print the tables of teachers that have some of the challenges only, too
        trials: print the verdicts of the trials by which teachers joined, too
        explain: print the definitions, too

    Examples:
        tma-ray leaderboard
        tma-ray leaderboard lite-2 --challenges
        tma-ray leaderboard colleague --explain
    """
    from analysis.commands.leaderboards import show_leaderboards

    names = [str(name) for name in baseline]
    show_leaderboards(names, explain=explain, challenges=challenges, subsets=subsets, trials=trials)
    return 0


@command()
def ranking(
    *root: options.Roots,
    baseline: options.Baselines = (),
    share: Annotated[float, value(SHARE, "X")] = 1.0,
    measure: options.Measure = options.HEADLINE,
    explain: bool = False,
    json: options.Json = False,
) -> int:
    """Rank the teachers by mastered tasks, over all challenges and on each.

    They are tested against Random.

    Args:
        root: results root, or the name of a baseline with runs; several are read as one
        share: share of the budget after which runs are read
        explain: print conclusions in sentences, and the definitions, too

    Examples:
        tma-ray ranking results
        tma-ray ranking results --baseline colleague
        tma-ray ranking results --share 0.5
        tma-ray ranking results --json
    """
    if json:
        print_json("ranking", ranking_record((*root, *baseline), share, measure))
        return 0
    from analysis.commands.rankings import show_ranking

    show_ranking((*root, *baseline), share, measure=measure, explain=explain)
    return 0


@command()
def claims(
    *root: options.Roots,
    baseline: options.Baselines = (),
    details: bool = False,
    explain: bool = False,
    json: options.Json = False,
) -> int:
    """Check the paper's claims against a results root.

    Args:
        root: results root, or the name of a baseline with runs; several are read as one
        details: print every statement, with its numbers
        explain: print what the words mean
    """
    if json:
        print_json("claims", claims_record((*root, *baseline)))
        return 0
    from analysis.commands.claims import show_claims

    show_claims((*root, *baseline), details, explain)
    return 0


@command()
def search(root: options.Root, /) -> int:
    """Print the best hyper-parameters of a search, and the paper's choice.

    Args:
        root: results root
    """
    from analysis.commands.rankings import show_search

    show_search(root)
    return 0


@command()
def tables(
    *root: options.Roots,
    baseline: options.Baselines = (),
    step: options.Count | None = None,
    format: Annotated[str, choice(("markdown", "latex", "csv"))] = "markdown",  # noqa: A002
    output: options.Output | None = None,
) -> int:
    """Write the paper's tables for any results.

    Args:
        root: results root, or the name of a baseline, as paper-2021; several are read as one
        step: steps after which runs are read (default: at their end)
        format: format of the tables
        output: folder for a file per table (default: print them)
    """
    from analysis.commands.paper import write_tables

    written = write_tables((*root, *baseline), step, format, output)
    _warn(written.warnings)
    print("\n".join(map(str, written.files)) if written.files else written.text)
    return 0


@command()
def figures(
    *root: options.Roots,
    baseline: options.Baselines = (),
    output: options.Output,
    format: Annotated[str, choice(("pdf", "svg"))] = "pdf",  # noqa: A002
    only: Annotated[str | None, value(named("the beginning of a figure's name"), "NAME")] = None,
) -> int:
    """Write the paper's figures for any results.

    Args:
        root: results root, or the name of a baseline, as paper-2021; several are read as one
        output: folder to write to
        format: vector format, written next to PNG
        only: beginning of the figures' names, as radar (default: all)
    """
    from analysis.commands.paper import write_figures

    written = write_figures((*root, *baseline), output, format, only or "")
    _warn((*written.warnings, *(f"left out: {text}" for text in written.left_out)))
    print("\n".join(map(str, written.files)))
    return 0


@command()
def compare(
    *root: options.Roots,
    baseline: Annotated[tuple[str, ...], values(named("a baseline"), "BASELINE")],
    output: options.Output | None = None,
    measure: options.Measure = options.HEADLINE,
) -> int:
    """Write a page that compares results with released baselines.

    Args:
        root: results root of your runs; several are read as one
        baseline: name of a baseline, as paper-2021, or folder or address of results; repeatable
        output: folder to write to, where the page has a folder named by its baselines (default: compare in
            the first ROOT)

    Examples:
        tma-ray compare results --baseline paper-2021
        tma-ray compare results --baseline colleague --output comparison
    """
    from analysis.pages.compare import write_comparison

    print(write_comparison(root, baseline, output, print, measure))
    return 0


@command()
def tensorboard(root: options.Root, folder: options.Folder, /, *, watch: bool = False) -> int:
    """Export the scalars of a results root as event files.

    Args:
        root: results root
        folder: folder to write to, for TensorBoard's --logdir
        watch: follow the campaign, until Ctrl-C
    """
    from analysis.tracking.event_folder import EventFolder

    with closing(EventFolder(root, folder)) as events:
        return _track(events, f"; to look at them: tensorboard --logdir {folder}", watch)


@command()
def wandb(
    root: options.Root,
    /,
    *,
    project: Annotated[str, value(named("a project"), "NAME")] = "tma_ray",
    entity: Annotated[str | None, value(named("a user or team"), "NAME")] = None,
    folder: options.Folder = Path("wandb"),
    offline: bool = False,
    watch: bool = False,
) -> int:
    """Send the scalars of a results root to Weights & Biases.

    Each run has its own ID, and runs that differ in their seed alone are a group. The same command continues.

    Args:
        root: results root
        project: project to send to
        entity: user or team that has the project (default: the one logged in)
        folder: folder that the library writes to
        offline: write to the folder only; 'wandb sync' sends it later
        watch: follow the campaign, until Ctrl-C

    Examples:
        tma-ray wandb results --project tma_ray --offline
    """
    from analysis.tracking.wandb_project import WandbProject

    later = f"; to send them: wandb sync {folder}/wandb/offline-run-*" if offline else ""
    return _track(WandbProject(root, project, entity, folder, offline=offline), later, watch)


def _track(tracker: Tracker, hint: str, follow: bool) -> int:
    """Export published results, once or, if `follow`, repeatedly until Ctrl-C."""
    from analysis.tracking.points import watch

    print(f"runs with news: {tracker.update()}{hint}", flush=True)
    for count in watch(tracker) if follow else ():
        print(f"runs with news: {count}", flush=True)
    return 0


def _warn(warnings: Iterable[str]) -> None:
    for warning in warnings:
        sys.stderr.write(f"tma-ray: warning: {warning}\n")

"""Writes the report of a root: one page that needs nothing but itself, tables and figures beside it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from datetime import UTC, datetime
from pathlib import Path

from analysis.baselines.sources import Sources, places_of, read
from analysis.claims.sources import decided, root_verdicts
from analysis.comparisons.findings import MASTERED
from analysis.comparisons.measured import TESTED, Measured, measure
from analysis.data.frames import COMPARISON, Frames
from analysis.formatting import number
from analysis.looks import shown_together
from analysis.measures.evaluations import ceilings_in_words
from analysis.measures.student_pools import runs_after
from analysis.measures.tested import how_tested
from analysis.pages.controls import controls
from analysis.pages.leading import leading
from analysis.pages.overall import overall_section
from analysis.pages.page import page, page_folder, write_page
from analysis.pages.report.captions import thresholds
from analysis.pages.report.downloads import Download, downloads
from analysis.pages.report.facts import counts_of, machines, settings, unfinished, what_ran
from analysis.pages.report.overview import overview
from analysis.pages.report.sections import Section, sections
from analysis.pages.report.videos import Video, by_comparison
from analysis.statistics import SIGNIFICANCE
from tma_ray.commands.installed import installed_version
from tma_ray.tasks import MASTERY_RETURN


def write_report(
    sources: Sources, output: Path | None = None, videos: Sequence[Video] = (), reload: int = 0
) -> Path:
    """Writes the report of a root, finished or not, with its tables.

    Args:
        sources: results roots and baselines with runs: folders, addresses, names.
        output: folder to write to; ``report`` in the first of `sources` if that is a folder.
        videos: to embed, of `videos.wanted_videos`.
        reload: time after which an open page reads itself again, s; 0 for never.

    Returns:
        The page, ``index.html`` in `output`; beside it figures (PNG) and tables (CSV).

    Raises:
        ResultsRootError: one of `sources` is not a results root.
        ValueError: an object store and no `output`.
    """
    output = report_folder(sources, output)
    frames = read(sources)
    measured = measure(frames)
    shown = leading(measured.finals, MASTERED.column, frames.cells["teacher"], COMPARISON)
    with shown_together(frames.cells["teacher"]):
        parts = list(sections(frames, measured, shown))
        tables = downloads(frames, measured)
        text = _render(frames, measured, parts, tables, videos, shown, reload)
    pictures = {f"{picture.name}.png": picture.png for part in parts for picture in part.pictures}
    return write_page(output, text, pictures | {table.name: table.content for table in tables})


def report_folder(sources: Sources, output: Path | None) -> Path:
    """Returns the folder that a report of `sources` is written to.

    Raises:
        ValueError: an object store and no `output`.
    """
    return page_folder(places_of(sources)[0], output, "report", "report")


def _render(
    frames: Frames,
    measured: Measured,
    parts: list[Section],
    tables: list[Download],
    videos: Sequence[Video],
    shown: Collection[str],
    reload: int,
) -> str:
    cells = frames.cells
    verdicts, notes = root_verdicts(frames)
    return page(
        "report.html.j2",
        reload=reload,
        campaigns=sorted(name for name in cells["campaign"].unique() if name),
        ran=what_ran(cells),
        counts=counts_of(cells),
        warnings=[*frames.notes, *notes],
        controls=controls(
            cells[COMPARISON].drop_duplicates().sort_values(COMPARISON),
            cells["teacher"],
            measured.evaluations["step"].unique(),
            shown,
        ),
        overview=list(overview(measured)),
        sections=parts,
        overall=overall_section(runs_after(frames)),
        videos=by_comparison(videos),
        tests=int((measured.tests["p"].notna() & (measured.tests["measure"] == TESTED[0])).sum()),
        verdicts=decided(verdicts),
        unfinished=unfinished(frames),
        settings=settings(cells),
        machines=machines(frames.machine_times),
        downloads=tables,
        mastery=thresholds(cells) or number(MASTERY_RETURN, 0),
        significance=SIGNIFICANCE,
        ceilings=ceilings_in_words(frames),
        how_tested=how_tested(MASTERED.column, "all teachers of a comparison against Random"),
        version=installed_version("tma_ray"),
        written=datetime.now(UTC),
    )

"""The commands that print the known baselines, and whether one is whole."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from analysis.baselines.catalogue import SHIPPED, Baseline, BaselineManifest, baselines
from analysis.baselines.verification import verify
from tma_ray.terminal import terminal


def show_baselines(console: Console | None = None) -> None:
    """Prints the baselines that have a name here: what they hold, under which licence, and where they lie.

    Raises:
        BaselineError: one is damaged.
    """
    table = Table("baseline", "engine", "runs", "teachers", "licence", box=None, pad_edge=False)
    table.add_column("where", overflow="fold")
    for baseline in baselines():
        manifest = baseline.manifest
        teachers = str(len(manifest.holds.get("teachers", ())))
        row = manifest.name, manifest.engine, _runs(manifest), teachers, manifest.licence or "none given"
        table.add_row(*row, _place(baseline))
    terminal(console).print(table)


def show_verification(name: str | Path, console: Console | None = None) -> bool:
    """Prints whether a baseline is what was released; returns that as well.

    Raises:
        BaselineError: no baseline of that name or place.
    """
    console = terminal(console)
    found = verify(name)
    files = found.baseline.manifest.files
    size = sum(file.size for file in files)
    if found.whole:
        console.print(
            f"{found.baseline.manifest.name} is whole: {len(files):,} files, {size:,} bytes", soft_wrap=True
        )
    for problem in found.problems:
        console.print(problem, markup=False, soft_wrap=True)
    return found.whole


def _place(baseline: Baseline) -> str:
    shipped = "://" not in baseline.place and Path(baseline.place).is_relative_to(SHIPPED)
    return "in the package" if shipped else baseline.place


def _runs(manifest: BaselineManifest) -> str:
    runs = f"{manifest.holds.get('runs', 0):,}"
    return f"{runs}, partial" if manifest.partial else runs

"""The history of one run: its attempts, their logs, and why it failed."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.text import Text

from tma_ray.campaign.monitor.wording import duration
from tma_ray.results import LOGS, Results, Table
from tma_ray.terminal import terminal


def show(run: str, root: str | Path, console: Console | None = None) -> None:
    """Prints the history of a run, from any machine that sees its results root.

    Args:
        run: its id, or the beginning of that of no other run.
        root: folder or URI of a results root.
        console: where to.

    Raises:
        ValueError: no such run, or several.
    """
    console, results = terminal(console), Results.open(root)
    manifest = results.find(run)
    run_id = manifest.run.run_id
    console.print(Text(f"{run_id}: {manifest.status}", style="bold"))
    for row in sorted(
        results.table(Table.ATTEMPTS, [run_id]).to_pylist(), key=lambda attempt: attempt["attempt"]
    ):
        console.print(
            f"attempt {row['attempt']}: {row['outcome']} after {duration(row['wall_seconds'])} "
            f"on {row['host'] or 'an unknown host'}, from {row['started_at']:%Y-%m-%d %H:%M:%S} UTC on",
            highlight=False,
        )
    logged = False
    for path in sorted(results.store.files(f"{LOGS}/{run_id}")):
        console.print(Text(f"\n{path}", style="bold"))
        text = results.store.read_bytes(path).decode(errors="replace").rstrip()
        console.print(text, markup=False, highlight=False, soft_wrap=True)
        logged = True
    if manifest.error and not logged:
        console.print(manifest.error.rstrip(), markup=False, highlight=False, soft_wrap=True)

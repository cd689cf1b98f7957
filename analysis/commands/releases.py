"""Releases in the terminal, and their findings as Markdown.

`console` is the terminal by default. An unknown or damaged release raises `BaselineError`, and an address
without results `ResultsRootError`.
"""

from collections import Counter
from pathlib import Path

from rich.console import Console
from rich.table import Table

from analysis.baselines import baselines, find_baseline
from analysis.baselines.catalogue import SHIPPED
from analysis.baselines.verification import verify
from analysis.claims.agreement import Agreement, agreements
from analysis.claims.judging import root_verdicts
from analysis.data.frames import object_strings
from analysis.formatting import number, steps_text
from analysis.names import challenge_title, label
from analysis.statistics.samples import DEFAULT_MARGIN, Standing
from analysis.tables.table import pipe_table
from tma_ray.console.terminal import terminal


def show_baselines(console: Console | None = None) -> None:
    """Print the known baselines with their contents, licence and location.

    Raises:
        BaselineError: if a baseline is damaged.
    """
    table = Table("baseline", "engine", "runs", "teachers", "licence", box=None, pad_edge=False)
    table.add_column("where", overflow="fold")
    for baseline in baselines():
        manifest, location = baseline.manifest, baseline.location
        runs = f"{manifest.holds.get('runs', 0):,}{', partial' if manifest.partial else ''}"
        teachers = str(len(manifest.holds.get("teachers", ())))
        row = manifest.name, manifest.engine, runs, teachers, manifest.licence or "none given"
        shipped = "://" not in location and Path(location).is_relative_to(SHIPPED)
        table.add_row(*row, "in the package" if shipped else location)
    terminal(console).print(table)


def show_verification(name: str | Path, console: Console | None = None) -> bool:
    """Verify a baseline, print the result, and return True if it is undamaged.

    Raises:
        BaselineError: if `name` is not a baseline.
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


TAU = (
    "Kendall's tau-b between the order of the teachers' means here and in the paper's tables: 1 is the same "
    "order, 0 none, -1 the reverse. The 95 % interval is a bootstrap over runs, and over normal runs with "
    "the means and deviations of the paper's tables: the range that as many other runs would give. Noise "
    "moves tau towards 0, so that the order of true means may agree better; an interval that contains 0 "
    "decides nothing."
)


@object_strings()
def findings(name: str) -> str:
    """Return the findings of a release as Markdown: claims of the paper, agreement of rankings.

    Raises:
        BaselineError: if the release does not exist, or has no runs.
    """
    baseline = find_baseline(name)
    manifest, holds, frames = baseline.manifest, baseline.manifest.holds, baseline.frames()
    steps, students = " and ".join(map(steps_text, holds["steps"])), ", ".join(map(label, holds["students"]))
    partial = f" The release is not complete: {manifest.partial}." if manifest.partial else ""
    verdicts, _ = root_verdicts(frames)
    counts = Counter(verdict.standing for verdict in verdicts)
    summary = ", ".join(f"{counts[standing]} {standing}" for standing in Standing if counts[standing])
    rows = [
        [verdict.claim.text, verdict.claim.source, verdict.standing_text, verdict.describe()]
        for verdict in verdicts
    ]
    parts = [
        f"From `{manifest.name}`: {holds['runs']:,} runs of {students}, {steps} steps each, simulated by "
        f"{manifest.engine}. The paper's runs are of SAC (PPO, too, for diverse students), 20 million steps "
        f"each, simulated by Box2D.{partial}",
        "## Claims",
        f"Of {len(verdicts)} claims: {summary}. A statement is supported where a 95 % "
        f"interval excludes its contrary, with a margin of {DEFAULT_MARGIN:g} points of mastered tasks, "
        f"within each body and student. A statement that the interval excludes is refuted under the paper's "
        f"conditions, and not seen here under others; otherwise it is undecided. No data: the release lacks "
        f"a level, body or teacher of the claim. Statements about the same runs count once.",
        pipe_table(["claim", "in the paper", "standing", "statements"], rows),
        "## The paper's order of teachers",
        TAU,
        pipe_table(["challenge", "teachers", "tau", "95 % interval"], map(_tau_row, agreements(frames))),
        "## Statement by statement",
    ]
    for verdict in verdicts:
        lines = [f"- {finding.standing}: {finding.evidence}" for finding in verdict.findings]
        text = verdict.standing_text
        parts.append("\n".join([f"**{text[0].upper()}{text[1:]}:** {verdict.claim.text}\n", *lines]))
    return "\n\n".join(parts)


def _tau_row(found: Agreement) -> list[str]:
    title = "mean over all of these"
    if found.levels:
        place = challenge_title(found.environment, found.challenge, found.challenge)
        title = f"{place}, expert knowledge {' and '.join(found.levels)}"
    teachers = str(len(found.teachers)) if found.teachers else ""
    interval = f"{number(found.low, 2)} to {number(found.high, 2)}"
    return [title, teachers, number(found.tau, 2), interval]

"""Releases at the terminal and as Markdown: list, verification, leaderboards, findings.

What is shown goes to `console`, by default the terminal. A release that does not exist, or is damaged, raises
`BaselineError`, and an address without results `ResultsRootError`.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from analysis.baselines import BaselineError, BaselineKind, as_baseline, baselines, find_baseline
from analysis.baselines.catalogue import SHIPPED, Baseline, read
from analysis.baselines.verification import verify
from analysis.charts.base import Chart
from analysis.charts.intervals import rank_chart
from analysis.claims.judging import Agreement, agreements, root_verdicts
from analysis.comparisons.boards import Entry, Leaderboard, leaderboards
from analysis.formatting import amount, caveat, estimate, number
from analysis.measures.evaluations import ceilings_in_words
from analysis.measures.tested import FINAL, HEADLINE, MEASURES, QUANTITIES, how_tested
from analysis.names import challenge_title, label
from analysis.statistics.samples import MARGIN, Standing
from analysis.tables.table import pipe_table
from tma_ray.terminal import terminal


def show_baselines(console: Console | None = None) -> None:
    """Print the known baselines with their contents, licence and place.

    Raises:
        BaselineError: a damaged baseline.
    """
    table = Table("baseline", "engine", "runs", "teachers", "licence", box=None, pad_edge=False)
    table.add_column("where", overflow="fold")
    for baseline in baselines():
        manifest, place = baseline.manifest, baseline.place
        runs = f"{manifest.holds.get('runs', 0):,}{', partial' if manifest.partial else ''}"
        teachers = str(len(manifest.holds.get("teachers", ())))
        row = manifest.name, manifest.engine, runs, teachers, manifest.licence or "none given"
        shipped = "://" not in place and Path(place).is_relative_to(SHIPPED)
        table.add_row(*row, "in the package" if shipped else place)
    terminal(console).print(table)


def show_verification(name: str | Path, console: Console | None = None) -> bool:
    """Print the verification of a baseline; return True if it is undamaged.

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


EXPLANATION = (
    f"{QUANTITIES[HEADLINE]}: mean over seeds and [its 95 % interval], and next to it the mean of the last "
    "three evaluations. Ranks are by the mean over training and over the challenges of a table, which weigh "
    "the same. In brackets are the ranks that tests over these challenges leave open: 1 [1 to 8] of ten "
    "teachers is the highest mean, found better than two others and not told from the other seven. Tests are "
    "Welch's, in which each variance counts with at least half of the mean of all teachers on a challenge, "
    "and paired by seed where seeds share a simulated student. "
    f"{how_tested(HEADLINE, 'all pairs of teachers of a table')} A teacher without results on all "
    "challenges is ranked on those that it has, in a table of its own. Trained is the share of the steps "
    "from which students learned; the others were spent on episodes that only score or try tasks. Hours "
    "are the median wall-clock hours of a run beside others on the same machine; the card of a release says "
    "which."
)

NO_BREAK = "\N{NO-BREAK SPACE}"

LINE = 80
"""Width of the terminal in characters."""

CHALLENGE_WIDTH, LEAST_TEACHER_WIDTH = 10, 14
"""Characters of a column, of which six and one fill a line."""


def show_leaderboards(names: Sequence[str], console: Console | None = None) -> None:
    """Print the leaderboards of releases.

    Args:
        names: names of releases, folders or addresses of results; all known releases by default.
        console: console to print on; the terminal by default.

    Raises:
        BaselineError: the release does not exist, or one is damaged.
        ResultsRootError: nothing lies at a place.
    """
    console = terminal(console)
    console.print(f"{EXPLANATION}\n", style="dim", highlight=False, markup=False)
    for name, place, partial in _places(names):
        console.print(f"{name}{f' (partial: {partial})' if partial else ''}", style="bold", highlight=False)
        frames = read(place)
        for sentence in ceilings_in_words(frames):
            console.print(sentence, style="dim", highlight=False)
        boards = leaderboards(frames)
        if not boards:
            console.print("No run has been evaluated here.")
        for board in boards:
            console.print(f"\n{board.title}", style="bold", highlight=False)
            console.print(_ranking(board))
            console.print(_challenges(board))
            console.print(_caveat(board), style="dim", highlight=False)


def rank_charts(names: Sequence[str] = ()) -> Iterator[tuple[str, Chart]]:
    """Yield file name and chart of each picture of `markdown`, of releases, by default of all known ones."""
    for name, place, _ in _places(names):
        for position, board in enumerate(leaderboards(read(place)), start=1):
            yield _picture(name, position), rank_chart({board.title: [entry.rank for entry in board.entries]})


def _picture(release: str, position: int) -> str:
    return f"{Path(release).name}-ranks-{position}.svg"


def markdown(names: Sequence[str] = (), pictures: str = ".") -> str:
    """Return the leaderboards of releases as Markdown.

    Args:
        names: names, folders or addresses of releases; all known ones by default.
        pictures: folder of the charts of `rank_charts`, from the folder of the page.
    """
    parts = []
    for name, place, partial in _places(names):
        parts.append(f"## {name}")
        parts += [f"*This release is not complete: {partial}.*"] if partial else []
        parts += ceilings_in_words(frames := read(place))
        for position, board in enumerate(leaderboards(frames), start=1):
            parts.append(f"### {board.title[0].upper()}{board.title[1:]}")
            parts.append(f"![Ranks, {board.title}]({pictures}/{_picture(name, position)})")
            heads = f"{MEASURES[HEADLINE]}, % [95 %]", f"{MEASURES[FINAL]}, %"
            head = ["teacher", "rank", *heads, *map(_short_title, board.challenges), "runs", *_further(board)]
            rows = []
            for entry in board.entries:
                rank, teacher, *others = _cells(board, entry)
                rows.append([teacher, *(text.replace(" ", NO_BREAK) for text in (rank, *others))])
            parts.append(pipe_table(head, rows, numbers=range(1, len(head))))
            parts += [text] if (text := _caveat(board)) else []
    return "\n\n".join([EXPLANATION, *(parts or ["No release with runs ships with this version."])])


def _further(board: Leaderboard) -> list[str]:
    return [*(["trained"] if board.partly_trained else []), *(["hours"] if board.timed else [])]


def _short_title(title: str) -> str:
    return title.removeprefix("Stump Tracks, ").removesuffix(" task space")


def _places(names: Sequence[str]) -> list[tuple[str, str, str]]:
    """Return name, place and gaps of releases with runs."""
    if not names:
        return [_told(each) for each in baselines() if each.manifest.kind is BaselineKind.RUNS]
    found = ((name, as_baseline(name)) for name in names)
    return [_told(each) if each else (name, name, "") for name, each in found]


def _told(baseline: Baseline) -> tuple[str, str, str]:
    if baseline.manifest.kind is not BaselineKind.RUNS:
        raise BaselineError(f"{baseline.manifest.name} has no runs, only published results: no leaderboard")
    return baseline.manifest.name, baseline.place, baseline.manifest.partial


def _caveat(board: Leaderboard) -> str:
    return caveat(min(entry.rank.fewest for entry in board.entries))


def _ranking(board: Leaderboard) -> Table:
    table = Table(box=None, pad_edge=False)
    heads = "rank", "teacher", f"{MEASURES[HEADLINE]}, % [95 %]", MEASURES[FINAL], "runs", *_further(board)
    lines = [_cells(board, entry) for entry in board.entries]
    lines = [[*line[:4], *line[4 + len(board.challenges) :]] for line in lines]
    for heading, cells in zip(heads, zip(*lines, strict=True), strict=True):
        if heading == "teacher":
            table.add_column(heading, overflow="fold")
        else:
            widths = map(len, (*cells, *heading.split()))
            table.add_column(heading, justify="right", width=max(widths))
    for line in lines:
        table.add_row(*line)
    return table


def _challenges(board: Leaderboard) -> Table:
    """Return results of teachers by challenge, without decimals so that six fit a line."""
    table = Table(box=None, pad_edge=False, padding=(0, 0, 0, 1))
    left = LINE - len(board.challenges) * (1 + CHALLENGE_WIDTH)
    table.add_column("teacher", max_width=max(LEAST_TEACHER_WIDTH, left), overflow="fold")
    for title in board.challenges:
        table.add_column(_short_title(title), justify="right", max_width=CHALLENGE_WIDTH, overflow="fold")
    for entry in board.entries:
        table.add_row(
            label(entry.rank.teacher), *(each.replace(", ", ",") for each in _results(board, entry))
        )
    return table


def _results(board: Leaderboard, entry: Entry) -> list[str]:
    known = (entry.results.get(title) for title in board.challenges)
    return [estimate(*each, 0) if each else "" for each in known]


def _cells(board: Leaderboard, entry: Entry) -> list[str]:
    rank = entry.rank
    open_ranks = f" [{rank.best} to {rank.worst}]" if rank.best < rank.worst else ""
    return [
        f"{rank.rank}{open_ranks}",
        label(rank.teacher),
        estimate(rank.mean, rank.low, rank.high),
        number(entry.final),
        *_results(board, entry),
        str(rank.n),
        *([f"{number(entry.trained, 0)} %"] if board.partly_trained else []),
        *([number(entry.hours, 2)] if board.timed else []),
    ]


TAU = (
    "Kendall's tau-b between the order of the teachers' means here and in the paper's tables: 1 is the same "
    "order, 0 none, -1 the reverse. The 95 % interval leaves open the order of each pair of teachers that "
    "Welch's tests do not tell apart on both sides, after Holm's correction; an interval with 0 in it "
    "decides nothing."
)


def findings(name: str) -> str:
    """Return the findings of a release as Markdown.

    Raises:
        BaselineError: the release does not exist, or it has no runs.
    """
    baseline = find_baseline(name)
    manifest, holds, frames = baseline.manifest, baseline.manifest.holds, baseline.frames()
    steps, students = " and ".join(map(amount, holds["steps"])), ", ".join(map(label, holds["students"]))
    partial = f" The release is not complete: {manifest.partial}." if manifest.partial else ""
    verdicts, _ = root_verdicts(frames)
    counts = Counter(verdict.standing for verdict in verdicts)
    summary = ", ".join(f"{counts[standing]} {standing}" for standing in Standing)
    rows = [
        [verdict.claim.text, verdict.claim.source, str(verdict.standing), verdict.describe()]
        for verdict in verdicts
    ]
    parts = [
        f"From `{manifest.name}`: {holds['runs']:,} runs of {students}, {steps} steps each, simulated by "
        f"{manifest.engine}. The paper's runs are of SAC (PPO, too, for diverse students), 20 million steps "
        f"each, simulated by Box2D.{partial}",
        "## Claims",
        f"Of {len(verdicts)} claims: {summary}. A statement is supported or refuted where a 95 % "
        f"interval rules out its contrary, against a margin of {MARGIN:g} points of mastered tasks; else "
        f"it is undecided. No data: the release lacks a level, body or teacher of the claim.",
        pipe_table(["claim", "in the paper", "standing", "statements"], rows),
        "## The paper's order of teachers",
        TAU,
        pipe_table(["challenge", "teachers", "tau", "95 % interval"], map(_tau_row, agreements(frames))),
        "## Statement by statement",
    ]
    for verdict in verdicts:
        lines = [f"- {finding.standing}: {finding.evidence}" for finding in verdict.findings]
        parts.append("\n".join([f"**{verdict.standing.capitalize()}:** {verdict.claim.text}\n", *lines]))
    return "\n\n".join(parts)


def _tau_row(found: Agreement) -> list[str]:
    title = "mean over all of these"
    if found.level is not None:
        place = challenge_title(found.environment, found.challenge, found.challenge)
        title = f"{place}, expert knowledge {found.level}"
    teachers = str(len(found.teachers)) if found.teachers else ""
    interval = f"{number(found.low, 2)} to {number(found.high, 2)}"
    return [title, teachers, number(found.tau, 2), interval]

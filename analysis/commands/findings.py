"""Findings of a release as Markdown: the paper's claims held against it, and agreement with its rankings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from analysis.baselines import BaselineKind, baselines, find_baseline
from analysis.baselines.catalogue import Baseline
from analysis.claims.agreement import Agreement, agreements
from analysis.claims.judging import Verdict, root_verdicts
from analysis.formatting import amount, number
from analysis.names import challenge_title
from analysis.statistics.samples import MARGIN, Standing
from tma_ray.results import CHIPMUNK

TAU = (
    "Kendall's tau-b between the order of the teachers' means here and in the paper's tables: 1 is the same "
    "order, 0 none, -1 the reverse. The 95 % interval leaves open the order of each pair of teachers that "
    "Welch's tests do not tell apart on both sides, after Holm's correction; an interval with 0 in it "
    "decides nothing."
)


def findings(name: str) -> str:
    """Returns the findings of a release as Markdown.

    Args:
        name: of the release, or its folder or address.

    Raises:
        BaselineError: the release does not exist, or it has no runs.
    """
    baseline = find_baseline(name)
    frames = baseline.frames()
    verdicts, _ = root_verdicts(frames)
    counts = Counter(verdict.standing for verdict in verdicts)
    summary = ", ".join(f"{counts[standing]} {standing}" for standing in Standing)
    rows = [
        [verdict.claim.text, verdict.claim.source, str(verdict.standing), verdict.describe()]
        for verdict in verdicts
    ]
    return "\n\n".join(
        [
            _introduction(baseline),
            "## Claims",
            f"Of {len(verdicts)} claims: {summary}. A statement is supported or refuted where a 95 % "
            f"interval rules out its contrary, against a margin of {MARGIN:g} points of mastered tasks; else "
            f"it is undecided. No data: the release lacks a level, body or teacher of the claim.",
            _table(["claim", "in the paper", "standing", "statements"], rows),
            "## The paper's order of teachers",
            TAU,
            _table(["challenge", "teachers", "tau", "95 % interval"], map(_tau_row, agreements(frames))),
            "## Statement by statement",
            *map(_details, verdicts),
        ]
    )


def shipped_findings() -> str:
    """Returns the findings of the release with most runs that ships with the package, as Markdown."""
    shipped = [each for each in baselines() if each.manifest.kind is BaselineKind.RUNS]
    simulated = [each for each in shipped if each.manifest.engine == CHIPMUNK]
    if not simulated:
        return "No release with runs ships with this version."
    return findings(max(simulated, key=lambda each: int(each.manifest.holds.get("runs", 0))).place)


def _introduction(baseline: Baseline) -> str:
    manifest = baseline.manifest
    holds = manifest.holds
    steps = " and ".join(map(amount, holds["steps"]))
    students = ", ".join(map(str, holds["students"])).upper()
    text = (
        f"From `{manifest.name}`: {holds['runs']:,} runs of {students}, {steps} steps each, simulated by "
        f"{manifest.engine}. The paper's runs are of SAC (PPO, too, for diverse students), 20 million steps "
        f"each, simulated by Box2D."
    )
    return f"{text} The release is not complete: {manifest.partial}." if manifest.partial else text


def _tau_row(found: Agreement) -> list[str]:
    title = "mean over all of these"
    if found.level is not None:
        place = challenge_title(found.environment, found.challenge, found.challenge)
        title = f"{place}, expert knowledge {found.level}"
    teachers = str(len(found.teachers)) if found.teachers else ""
    interval = f"{number(found.low, 2)} to {number(found.high, 2)}"
    return [title, teachers, number(found.tau, 2), interval]


def _details(verdict: Verdict) -> str:
    lines = [f"- {finding.standing}: {finding.evidence}" for finding in verdict.findings]
    return "\n".join([f"**{verdict.standing.capitalize()}:** {verdict.claim.text}\n", *lines])


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)

"""Packing a finished campaign: a folder that others load, verify and cite."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final
from uuid import uuid4

import pandas as pd

from analysis.baselines.card import CARD_FILE, card, holdings, made_on
from analysis.baselines.catalogue import (
    BASELINE_FILE,
    UNSAID,
    About,
    Baseline,
    BaselineError,
    BaselineFile,
    BaselineKind,
    BaselineManifest,
)
from analysis.baselines.croissant import CROISSANT_FILE, croissant
from analysis.baselines.verification import verify
from analysis.data.frames import STATUSES, Frames, load
from analysis.measures.evaluations import ceilings_in_words
from analysis.tables.paper_tables import result_tables, table_results
from analysis.tables.table import Table as ResultTable
from tma_ray.arguments import check_known
from tma_ray.commands.exits import installed_version
from tma_ray.commands.values import expanded
from tma_ray.results import (
    CHIPMUNK,
    SCHEMA_VERSION,
    SIMULATED,
    WHOLE,
    Contents,
    Copy,
    Results,
    RunStatus,
    Shard,
    Store,
    Table,
    add_shard,
    check_id,
    copy_merged,
    holder_of,
)

HELD: Final = {
    "campaigns": "campaign",
    "experiments": "experiment",
    "environments": "environment",
    "challenges": "challenge",
    "embodiments": "embodiment",
    "students": "student",
    "teachers": "teacher",
    "expert_knowledge": "expert_knowledge",
    "steps": "steps",
    "seeds": "seed",
}
"""Columns of cells by the names under which a manifest lists their values."""


def release(
    root: str | Path,
    name: str,
    output: Path | None = None,
    licence: str = "",
    *,
    partial: bool = False,
    contents: Contents = WHOLE,
    about: About = UNSAID,
) -> Path:
    """Pack the campaigns of a root that are done into a folder of files that need nothing else.

    It is a results root of its own: `analysis.load` reads it as it reads `root`, from a disk or an
    object store, without ray or torch. Checkpoints and logs stay behind, and so does what is neither JSON
    nor safetensors of a policy.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address, on which no campaign is running.
        name: name of the release and its folder.
        output: folder in which that is made; the current one by default.
        licence: terms under which others may use it, an SPDX identifier such as ``CC-BY-4.0``.
        partial: pack campaigns that are not done or are damaged as well, and say so.
        contents: `tma_ray.results.LEAN` leaves out episodes, logs of teachers, policies, names of machines.
        about: statements that its runs do not make; by default those of a release that is packed again.

    Returns:
        The new folder.

    Raises:
        ResultsRootError: no results root at that place.
        BaselineError: a campaign is at work on the root, a run is not done, the root holds none or is
            damaged, or the folder exists.
        DamagedFileError: a newer version wrote columns that would be lost.
    """
    folder = _new_folder(name, output or Path())
    frames = load(root)
    grown = _as_release(frames)
    missing = _refuse_unfinished(frames, partial, grown.partial if grown else "")
    folder.parent.mkdir(parents=True, exist_ok=True)
    aside = folder.parent / f".{name}-{uuid4().hex[:8]}"
    try:
        store = Store.open(aside)
        copy = copy_merged(frames.results, store, contents)
        refuse_damaged(copy.damaged, partial)
        licence = licence or (grown.licence if grown else "")
        describe(aside, name, licence, missing, copy, about.or_of(grown), grown.planned if grown else {})
        aside.rename(folder)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return folder


def describe(
    place: Path,
    name: str,
    licence: str,
    missing: str,
    copy: Copy | Shard,
    about: About,
    planned: Mapping[str, int],
) -> None:
    """Write card, metadata and manifest of a root that was copied to `place`, and verify all of it.

    Raises:
        BaselineError: it is not as it should be.
        ValueError: it has no campaign of a name in the core.
    """
    store = Store.open(place)
    (place / "tmp").rmdir()  # empty, since all that was written is in its place
    for file in (CARD_FILE, CROISSANT_FILE, BASELINE_FILE):
        (place / file).unlink(missing_ok=True)
    released = load(place)
    for campaign in about.core:
        check_known("campaign", campaign, set(released.cells["campaign"]), "the release has")
    manifest = _manifest(released, name, licence, missing, copy, store)
    manifest = replace(manifest, core=about.core, gaps=about.gaps, planned=dict(planned))
    made = _made(released)
    text = card(manifest, made, tables=_tables(released), ceilings=ceilings_in_words(released))
    (place / CARD_FILE).write_text(text, encoding="utf-8")
    files = tuple(BaselineFile.of(store, path) for path in store.files())
    described = json.dumps(croissant(manifest, files, made), indent=1, ensure_ascii=False)
    (place / CROISSANT_FILE).write_text(f"{described}\n", encoding="utf-8")
    files = tuple(BaselineFile.of(store, path) for path in store.files())
    (place / BASELINE_FILE).write_bytes(replace(manifest, files=files).to_bytes())
    problems = verify(place).problems
    if problems:
        raise BaselineError(f"{place} was not written as it should be: {problems[0]}; try another disk")


def release_folder(name: str, output: Path) -> Path:
    """Return the folder of a release of this name within `output`.

    Raises:
        BaselineError: the name has other characters, or `output` is not on a disk.
    """
    if not re.fullmatch(r"[0-9a-zA-Z][0-9a-zA-Z._-]*", name):
        raise BaselineError(
            f"release {name!r}: use letters, digits, '.', '_' and '-', a letter or digit first"
        )
    if "://" in str(output):
        raise BaselineError(f"{output} is not a local folder: pack the release on a disk, then publish it")
    return expanded(output) / name


def _new_folder(name: str, output: Path) -> Path:
    folder = release_folder(name, output)
    if folder.exists():
        raise BaselineError(f"{folder} exists: a release is never overwritten; choose another name or folder")
    return folder


def _as_release(frames: Frames) -> BaselineManifest | None:
    store = frames.results.store
    return BaselineManifest.load(store) if store.holds(BASELINE_FILE) else None


def _refuse_unfinished(frames: Frames, partial: bool, lacking: str = "") -> str:
    """Return the gaps of the campaigns, in words, if they are allowed.

    Args:
        frames: results of the root.
        partial: True if something may be missing.
        lacking: gaps of a release that is packed again, in words.
    """
    holder = holder_of(frames.results.store)
    if holder is not None:
        raise BaselineError(f"{holder} is at work on the root: wait for its end, or stop it first")
    refuse_damaged(frames.results.problems, partial)
    if frames.cells.empty:
        raise BaselineError("the root holds no runs: there is nothing to release")
    runs = frames.cells.drop_duplicates("run_id")["status"]
    counts = {status: int((runs == status).sum()) for status in STATUSES if status != "done"}
    words = ", ".join(f"{count:,} {status}" for status, count in counts.items() if count)
    done = f"{int((runs == 'done').sum()):,} of {len(runs):,} runs are done"
    missing = f"{done}, {words}" if words else lacking
    if missing and not partial:
        raise BaselineError(f"{missing}: finish the campaign, or release it as it is with --partial")
    return missing


def refuse_damaged(problems: Sequence[str], partial: bool) -> None:
    """Refuse a root with damaged files unless a part of it will do.

    Raises:
        BaselineError: the message names the first.
    """
    if problems and not partial:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise BaselineError(
            f"the root is damaged: {problems[0]}{more}; start its campaign again, which does damaged runs "
            f"again, or leave out what is damaged with --partial"
        )


def _manifest(
    frames: Frames, name: str, licence: str, missing: str, copy: Copy | Shard, store: Store
) -> BaselineManifest:
    cells = frames.cells.astype({"seed": object})
    columns = {title: cells[column].dropna().tolist() for title, column in HELD.items()}
    columns |= {
        "steps": [int(steps) for steps in columns["steps"]],
        "seeds": [int(seed) for seed in columns["seeds"]],
    }
    evaluations = frames.evaluations.drop_duplicates(["run_id", "step"])
    counts = {"runs": len(frames.results.runs()), "evaluations": len(evaluations)}
    counts["policies"] = len({path.split("/")[1] for path in store.files("policies")})
    caveats = [*frames.warnings]
    if copy.policy_files:
        caveats.append(
            f"{len(copy.policy_files)} files of policies were left out, being neither JSON nor safetensors."
        )
    caveats += [f"Left out, being damaged: {problem}" for problem in copy.damaged]
    if not counts["policies"]:
        caveats.append("It holds no policies.")
    elif counts["policies"] < counts["runs"]:
        caveats.append(f"{counts['runs'] - counts['policies']} of {counts['runs']} runs have no policy here.")
    engines = " and ".join(sorted(cells["engine"].unique()))
    caveats.append(f"Results of other engines than {engines} are other numbers: compare ranks, pool nothing.")
    if frames.attempts["host"].astype(str).ne("").any():
        caveats.append("The table of attempts names the machines that the runs were made on.")
    return BaselineManifest(
        name=name,
        kind=BaselineKind.RUNS,
        schema_version=SCHEMA_VERSION,
        engine=engines,
        physics_versions=_physics_versions(cells),
        licence=licence,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        software=f"tma_ray {installed_version('tma_ray')}",
        partial=missing,
        caveats=tuple(caveats),
        holds=holdings(columns, counts),
        benchmark_versions=tuple(sorted({each.run.benchmark_version for each in frames.results.runs()})),
    )


def _physics_versions(cells: pd.DataFrame) -> tuple[int, ...]:
    """Return the versions of our physics among runs; none for those of other engines."""
    own = cells.loc[cells["engine"] == CHIPMUNK, "physics_version"].dropna()
    return tuple(sorted({int(value) for value in own}))


def _made(frames: Frames) -> str:
    """Return the origin of the runs, in words."""
    engines = set(frames.cells["engine"])
    others = sorted(engines - {CHIPMUNK, SIMULATED})
    text = f"Imported from results that others made in worlds of {', '.join(others)}." if others else ""
    if SIMULATED in engines:
        text += " By `tma-ray simulate`: students are equations, without physics."
    if CHIPMUNK in engines:
        versions = ", ".join(map(str, _physics_versions(frames.cells)))
        text += (
            f" By campaigns of tma_ray with its {CHIPMUNK} worlds, physics version {versions or 'unknown'}."
        )
    attempts = frames.attempts
    if len(attempts):
        runs = frames.cells.drop_duplicates("run_id").set_index("run_id")
        text += f" {made_on(attempts, runs['seed'])}"
    return text.strip() + " Every run has its whole specification in the column `spec` of the table `runs`."


def _tables(frames: Frames) -> list[ResultTable]:
    return [table for results in table_results(frames) for table in result_tables(results)]


def add_to_release(
    root: str | Path,
    name: str,
    shard: str,
    output: Path | None = None,
    licence: str = "",
    *,
    about: About = UNSAID,
) -> Path:
    """Add to a release the runs of a root that are done and that it lacks, as one file per table.

    The release is made if there is none. It holds evaluations, windows of training, curricula, cells, runs
    and attempts without names of machines; neither episodes, logs of teachers nor policies. Its other files
    stay as they are, but for its card, ``croissant.json`` and ``baseline.json``. A campaign may be running on
    the root. If this is interrupted, the release is as it was before.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.
        name: name of the release and its folder.
        shard: name of the new files: letters, digits, "_" and "-".
        output: folder in which the release lies; the current one by default.
        licence: see `releasing.release`; by default what the release has.
        about: statements that its runs do not make; by default those of the release.

    Returns:
        The folder of the release.

    Raises:
        ResultsRootError: `root` does not exist, or a shard of that name does.
        BaselineError: the root has no run that the release lacks, or is damaged; the release is damaged, or
            other files lie in its folder, which would be lost.
    """
    check_id(shard)
    folder = release_folder(name, output or Path())
    results = Results.open(root)
    refuse_damaged(results.problems, partial=False)
    folder.parent.mkdir(parents=True, exist_ok=True)
    aside = folder.parent / f".{name}-{uuid4().hex[:8]}"
    try:
        before = _copied(folder, aside)
        store = Store.open(aside)
        added = add_shard(results, store, shard)
        _refuse_nothing(added, results, folder)
        planned = _most(before.planned if before else {}, _planned(results))
        missing = _missing(Results(store), planned)
        licence = licence or (before.licence if before else "")
        describe(aside, name, licence, missing, added, about.or_of(before), planned)
        _replace(folder, aside)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return folder


def _refuse_nothing(added: Shard, results: Results, folder: Path) -> None:
    refuse_damaged(added.damaged, partial=False)
    if not added.runs and not added.cells:
        raise BaselineError(
            f"{results.store} has no finished run that {folder} lacks: there is nothing to add"
        )


def _copied(folder: Path, aside: Path) -> BaselineManifest | None:
    """Copy a release that is there, and return its manifest.

    Raises:
        BaselineError: it is damaged, or other files lie in its folder.
    """
    if not folder.exists():
        return None
    manifest = Baseline.open(folder).manifest
    known = {*(file.path for file in manifest.files), BASELINE_FILE}
    for path in sorted(folder.rglob("*")):
        file = path.relative_to(folder).as_posix()
        if file not in known and (path.is_symlink() or not path.is_dir()):
            raise BaselineError(f"{path} is not of the release, which is replaced as a whole: move it first")
    for file in sorted(known):
        (aside / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(folder / file, aside / file)
    return manifest


def _replace(folder: Path, aside: Path) -> None:
    """Put the folder `aside` in the place of another."""
    old = folder.parent / f".{folder.name}-{uuid4().hex[:8]}-old"
    if folder.exists():
        folder.rename(old)
    aside.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def _planned(results: Results) -> dict[str, int]:
    """Return the number of runs that each campaign of a root plans."""
    cells = results.table(Table.CELLS, columns=["campaign", "run_id"]).to_pandas()
    counts = cells.astype(str).groupby("campaign")["run_id"].nunique()
    return {str(campaign): int(count) for campaign, count in counts.items()}


def _most(counts: Mapping[str, int], others: Mapping[str, int]) -> dict[str, int]:
    """Return the larger count of each name: a root that began with a shard knows a part of its campaign."""
    names = sorted({*counts, *others})
    return {name: max(counts.get(name, 0), others.get(name, 0)) for name in names}


def _missing(results: Results, planned: dict[str, int]) -> str:
    """Return the runs that a release lacks of its campaigns, in words."""
    done = {manifest.run.run_id for manifest in results.runs() if manifest.status is RunStatus.DONE}
    cells = results.table(Table.CELLS, columns=["campaign", "run_id"]).to_pandas().astype(str)
    held = cells[cells["run_id"].isin(done)].groupby("campaign")["run_id"].nunique()
    counts = {campaign: (int(held.get(campaign, 0)), count) for campaign, count in planned.items()}
    short = {campaign: pair for campaign, pair in counts.items() if pair[0] < pair[1]}
    return "; ".join(f"{name} has {held} of {planned:,} runs" for name, (held, planned) in short.items())

"""Packing of campaigns as releases that others can load, verify and cite."""

import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final
from uuid import uuid4

import pyarrow.parquet as pq

from analysis.baselines.catalogue import (
    BASELINE_FILE,
    DEFAULT_ABOUT,
    About,
    Baseline,
    BaselineError,
    BaselineFile,
    BaselineKind,
    BaselineManifest,
)
from analysis.baselines.description import CARD_FILE, CROISSANT_FILE, card, croissant, holdings, origin
from analysis.baselines.verification import verify
from analysis.data.frames import STATUSES, Frames
from analysis.data.loading import load
from analysis.data.reference import random_cells
from analysis.measures.evaluations import ceiling_sentences
from analysis.measures.run_measures import run_measures
from analysis.measures.tested import HEADLINE
from analysis.tables.paper_tables import result_tables, table_results
from tma_ray import results
from tma_ray.console.exit_codes import installed_version
from tma_ray.support.quantities import expanded
from tma_ray.support.validation import check_known

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
"""Columns of cells, by the key of their values in a manifest."""


def release(
    root: str | Path,
    name: str,
    output: Path | None = None,
    licence: str = "",
    *,
    partial: bool = False,
    contents: results.CopyOptions = results.WHOLE,
    about: About = DEFAULT_ABOUT,
) -> Path:
    """Pack the finished campaigns of a root into a folder that is itself a results root.

    Checkpoints, logs, and files of policies other than JSON and safetensors are left out.

    Args:
        root: folder, or ``s3://`` or ``gs://`` address, without a running campaign.
        name: name of the release and its folder.
        output: parent folder; the current one by default.
        licence: SPDX identifier, such as ``CC-BY-4.0``.
        partial: True to pack unfinished and damaged campaigns, too.
        contents: contents of the release; `tma_ray.results.LEAN` for a small one.
        about: facts that the runs do not contain; by default those of a release that is packed again.

    Returns:
        The new folder.

    Raises:
        ResultsRootError: if the results root is missing.
        BaselineError: if a campaign is running, a run is not done, the root is empty or damaged, or the
            folder exists.
        DamagedFileError: if columns of a newer version would be lost.
    """
    folder = _release_folder(name, output)
    if folder.exists():
        raise BaselineError(f"{folder} exists: a release is never overwritten; choose another name or folder")
    frames = load(root)
    store = frames.results.store
    before = BaselineManifest.load(store) if store.holds(BASELINE_FILE) else None
    missing = _refuse_unfinished(frames, partial, before.partial if before else "")
    lacking = [missing, "" if contents.runs is None else "of each cell one run, that with the median result"]
    draft = _draft(
        name, licence, about, before, "; ".join(filter(None, lacking)), before.planned if before else {}
    )
    with _aside(folder) as aside:
        copy = results.copy_merged(frames.results, results.Store.open(aside), contents)
        _refuse_damaged(copy.damaged, partial)
        _complete(draft, aside, copy)
        aside.rename(folder)
    return folder


@contextmanager
def _aside(folder: Path) -> Iterator[Path]:
    """Context manager that yields an unused path next to `folder`, and deletes any folder there on exit."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    aside = folder.parent / f".{folder.name}-{uuid4().hex[:8]}"
    try:
        yield aside
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _draft(
    name: str,
    licence: str,
    about: About,
    before: BaselineManifest | None,
    missing: str,
    planned: Mapping[str, int],
) -> BaselineManifest:
    """Return a manifest without contents, with defaults from `before`, the previous manifest."""
    return BaselineManifest(
        name=name,
        kind=BaselineKind.RUNS,
        schema_version=results.SCHEMA_VERSION,
        engine="",
        physics_versions=(),
        licence=licence or (before.licence if before else ""),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        software=f"tma_ray {installed_version('tma_ray')}",
        partial=missing,
        core=about.core or (before.core if before else ()),
        planned=dict(sorted(planned.items())),
        gaps=about.gaps or (before.gaps if before else ""),
        budget_note=about.budget_note or (before.budget_note if before else ""),
        trial_cells=about.trial_cells or (before.trial_cells if before else ()),
    )


def _complete(draft: BaselineManifest, folder: Path, copied: results.Copy | results.Shard) -> None:
    """Write the card, metadata and manifest of a copied root, and verify the release.

    Raises:
        BaselineError: if the release is damaged.
        ValueError: if a campaign of the core or a cell of trials is missing.
    """
    store = results.Store.open(folder)
    (folder / "tmp").rmdir()
    for file in (CARD_FILE, CROISSANT_FILE, BASELINE_FILE):
        (folder / file).unlink(missing_ok=True)
    frames = load(folder)
    for campaign in draft.core:
        check_known("campaign", campaign, set(frames.cells["campaign"]), "the release has")
    cells = random_cells(frames.with_core(draft.core).cells)
    for cell in draft.trial_cells:
        check_known("cell", cell, cells, "the release has")
    manifest = _with_contents(draft, frames, copied)
    made = origin(frames, manifest.physics_versions)
    tables = (table for group in table_results(frames) for table in result_tables(group))
    parquet = {path: pq.read_metadata(folder / path) for path in store.files(results.TABLES)}
    filled = [path for path, content in parquet.items() if content.num_rows]
    text = card(manifest, made, tables, ceilings=ceiling_sentences(frames), paths=filled)
    (folder / CARD_FILE).write_text(text, encoding="utf-8")
    files = tuple(BaselineFile.of(store, path) for path in store.files())
    columns = {path: set(content.schema.to_arrow_schema().names) for path, content in parquet.items()}
    metadata = json.dumps(croissant(manifest, files, made, columns), indent=1, ensure_ascii=False)
    (folder / CROISSANT_FILE).write_text(f"{metadata}\n", encoding="utf-8")
    files = tuple(BaselineFile.of(store, path) for path in store.files())
    (folder / BASELINE_FILE).write_bytes(replace(manifest, files=files).to_bytes())
    problems = verify(folder).problems
    if problems:
        raise BaselineError(f"{folder} was not written as it should be: {problems[0]}; try another disk")


def _release_folder(name: str, output: Path | None) -> Path:
    """Return the folder of the release `name` in `output` (the current folder if None)."""
    if not re.fullmatch(r"[0-9a-zA-Z][0-9a-zA-Z._-]*", name):
        raise BaselineError(
            f"release {name!r}: use letters, digits, '.', '_' and '-', a letter or digit first"
        )
    if "://" in str(output):
        raise BaselineError(f"{output} is not a local folder: pack the release on a disk, then publish it")
    return expanded(output or Path()) / name


def _refuse_unfinished(frames: Frames, partial: bool, lacking: str) -> str:
    """Refuse a root that is in use, damaged or unfinished, and return a description of its missing runs.

    The description is `lacking` if the root is finished.

    Raises:
        BaselineError: if a campaign is running, or the root is empty or, unless `partial`, incomplete.
    """
    holder = results.holder_of(frames.results.store)
    if holder is not None:
        raise BaselineError(f"{holder} is at work on the root: wait for its end, or stop it first")
    _refuse_damaged(frames.results.problems, partial)
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


def _refuse_damaged(problems: Sequence[str], partial: bool) -> None:
    if problems and not partial:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise BaselineError(
            f"the root is damaged: {problems[0]}{more}; start its campaign again, which does damaged runs "
            f"again, or leave out what is damaged with --partial"
        )


def _with_contents(
    draft: BaselineManifest, frames: Frames, copied: results.Copy | results.Shard
) -> BaselineManifest:
    """Return a copy of a manifest, with contents and caveats derived from the release's tables."""
    cells, runs = frames.cells, frames.results.runs()
    columns = {name: cells[column].astype(object).dropna().tolist() for name, column in HELD.items()}
    columns |= {name: list(map(int, columns[name])) for name in ("steps", "seeds")}
    policies = len(_runs_with_policies(frames))
    evaluations = len(frames.evaluations.drop_duplicates(["run_id", "step"]))
    counts = {"runs": len(runs), "evaluations": evaluations, "policies": policies}
    caveats = [*frames.warnings]
    if copied.policy_files:
        count = len(copied.policy_files)
        caveats.append(f"{count} files of policies were left out, being neither JSON nor safetensors.")
    caveats += [f"Left out, being damaged: {problem}" for problem in copied.damaged]
    if not policies:
        caveats.append("It holds no policies.")
    elif policies < len(runs):
        caveats.append(f"{len(runs) - policies} of {len(runs)} runs have no policy here.")
    engines = " and ".join(sorted(cells["engine"].unique()))
    caveats.append(f"Results of other engines than {engines} are other numbers: compare ranks, pool nothing.")
    if frames.attempts["host"].astype(str).ne("").any():
        caveats.append("The table of attempts names the machines that the runs were made on.")
    physics = cells.loc[cells["engine"] == results.CHIPMUNK, "physics_version"].dropna()
    ended = cells[cells["status"] == "done"].groupby("campaign")["run_id"].nunique()
    done = {campaign: int(ended.get(campaign, 0)) for campaign in draft.planned}
    missing = (
        f"{campaign} has {done[campaign]} of {count:,} runs"
        for campaign, count in draft.planned.items()
        if done[campaign] < count
    )
    return replace(
        draft,
        partial=draft.partial or "; ".join(missing),
        done=done,
        engine=engines,
        physics_versions=tuple(sorted({int(version) for version in physics})),
        caveats=tuple(caveats),
        holds=holdings(columns, counts),
        benchmark_versions=tuple(sorted({run.run.benchmark_version for run in runs})),
    )


def add_to_release(
    root: str | Path,
    name: str,
    shard: str,
    output: Path | None = None,
    licence: str = "",
    *,
    about: About = DEFAULT_ABOUT,
) -> Path:
    """Add a root's new finished runs to a release (created if missing), as one lean file per table.

    Without new runs, facts alone can be changed. The other files of the release stay, except its card and
    metadata. A campaign may be running on the root. An interruption leaves the release unchanged.

    Args:
        root: folder, or ``s3://`` or ``gs://`` address.
        name: name of the release and its folder.
        shard: name of the new files: letters, digits, "_" and "-".
        output: parent folder of the release; the current one by default.
        licence: SPDX identifier; by default that of the release.
        about: facts that the runs do not contain; by default those of the release.

    Returns:
        The folder of the release.

    Raises:
        ResultsRootError: if `root` does not exist, or a shard of that name exists already.
        BaselineError: if there are neither new runs nor facts, root or release are damaged, or the release's
            folder holds other files.
    """
    results.check_id(shard)
    folder = _release_folder(name, output)
    source = results.Results.open(root)
    _refuse_damaged(source.problems, partial=False)
    with _aside(folder) as aside:
        before = _copied(folder, aside) if folder.exists() else None
        store = results.Store.open(aside)
        added = results.add_shard(source, store, shard)
        _refuse_damaged(added.damaged, partial=False)
        if not added.runs and not added.cells and (before is None or about == DEFAULT_ABOUT):
            raise BaselineError(
                f"{source.store} has no finished run that {folder} lacks: there is nothing to add"
            )
        cells = source.table(results.Table.CELLS, columns=["campaign", "run_id"]).to_pandas().astype(str)
        planned = cells.groupby("campaign")["run_id"].nunique().to_dict()
        for campaign, count in before.planned.items() if before else ():
            planned[campaign] = max(count, planned.get(campaign, 0))  # the root may now list fewer runs
        _complete(_draft(name, licence, about, before, "", planned), aside, added)
        if folder.exists():
            old = folder.parent / f".{folder.name}-{uuid4().hex[:8]}-old"
            folder.rename(old)
            aside.rename(folder)
            shutil.rmtree(old, ignore_errors=True)
        else:
            aside.rename(folder)
    return folder


def _copied(folder: Path, aside: Path) -> BaselineManifest:
    """Copy a release to `aside`, including hidden files such as .DS_Store, and return its manifest.

    Raises:
        BaselineError: if the release is damaged, or its folder holds other files or hidden folders.
    """
    manifest = Baseline.open(folder).manifest
    released = {*(file.path for file in manifest.files), BASELINE_FILE}
    hidden = set()
    for path in sorted(folder.rglob("*")):
        file = path.relative_to(folder)
        if file.as_posix() in released or (path.is_dir() and not path.is_symlink()):
            continue
        if not file.name.startswith(".") or any(name.startswith(".") for name in file.parts[:-1]):
            raise BaselineError(f"{path} is not of the release, which is replaced as a whole: move it first")
        hidden.add(file.as_posix())
    for name in sorted(released | hidden):
        (aside / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(folder / name, aside / name, follow_symlinks=False)
    return manifest


def median_policies(root: str | Path, core: Sequence[str] = ()) -> results.CopyOptions:
    """Return the options of a lean release that keeps the policy of each cell's median run by `HEADLINE`.

    The weights are float16.

    Args:
        root: folder, or ``s3://`` or ``gs://`` address.
        core: campaigns whose cells have a policy; all by default.

    Raises:
        ResultsRootError: if the results root is missing.
        BaselineError: if a median run has no policy.
        ValueError: if a campaign of `core` is missing.
    """
    frames = load(root)
    for campaign in core:
        check_known("campaign", campaign, set(frames.cells["campaign"]), "the root has")
    cells = frames.cells[frames.cells["campaign"].isin(core)] if core else frames.cells
    runs = cells.drop_duplicates("run_id")[["run_id", "teacher", "settings", "seed"]]
    runs = runs.merge(run_measures(frames, training=False)).dropna(subset=[HEADLINE])
    ordered = runs.sort_values([HEADLINE, "seed"]).groupby(["teacher", "settings"], observed=True)["run_id"]
    middle = frozenset(str(run_ids.iloc[(len(run_ids) - 1) // 2]) for _, run_ids in ordered)
    if lacking := sorted(middle - _runs_with_policies(frames)):
        raise BaselineError(
            f"{len(lacking)} of {len(middle)} runs in the middle of their cells have no policy in "
            f"{frames.results.store.where(results.POLICIES)}, as {lacking[0]}: release the root that they "
            f"ended in"
        )
    return replace(results.LEAN, policies=True, runs=middle)


def _runs_with_policies(frames: Frames) -> set[str]:
    return {path.split("/")[1] for path in frames.results.store.files(results.POLICIES)}

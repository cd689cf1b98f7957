"""Releases that grow: a shard for each batch of runs, and nothing that was released changes."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from uuid import uuid4

from analysis.baselines.catalogue import Baseline
from analysis.baselines.manifest import BASELINE_FILE, UNSAID, About, BaselineError, BaselineManifest
from analysis.baselines.releasing import describe, refuse_damaged, release_folder
from tma_ray.results import Results, RunStatus, Shard, Store, Table, add_shard, check_id


def add_to_release(
    root: str | Path,
    name: str,
    shard: str,
    output: Path | None = None,
    licence: str = "",
    *,
    about: About = UNSAID,
) -> Path:
    """Adds to a release the runs of a root that are done and that it lacks, as one file per table.

    The release is made if there is none. It holds evaluations, windows of training, curricula, cells, runs
    and attempts without names of machines; neither episodes, logs of teachers nor policies. Its other files
    stay as they are, but for its card and ``baseline.json``. A campaign may be running on the root. If this
    is interrupted, the release is as it was before.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.
        name: of the release and its folder.
        shard: name of the new files: letters, digits, "_" and "-".
        output: folder in which the release lies; the current one by default.
        licence: see `releasing.release`; by default what the release has.
        about: what its runs do not tell; by default what the release has.

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
    """Copies a release that is there, and returns its manifest.

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
    """Puts the folder `aside` in the place of another."""
    old = folder.parent / f".{folder.name}-{uuid4().hex[:8]}-old"
    if folder.exists():
        folder.rename(old)
    aside.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def _planned(results: Results) -> dict[str, int]:
    """Returns how many runs each campaign of a root comes to."""
    cells = results.table(Table.CELLS, columns=["campaign", "run_id"]).to_pandas()
    counts = cells.astype(str).groupby("campaign")["run_id"].nunique()
    return {str(campaign): int(count) for campaign, count in counts.items()}


def _most(counts: Mapping[str, int], others: Mapping[str, int]) -> dict[str, int]:
    """Returns the larger count of each name: a root that began with a shard knows a part of its campaign."""
    names = sorted({*counts, *others})
    return {name: max(counts.get(name, 0), others.get(name, 0)) for name in names}


def _missing(results: Results, planned: dict[str, int]) -> str:
    """Returns what a release lacks of its campaigns, in words."""
    done = {manifest.run.run_id for manifest in results.runs() if manifest.status is RunStatus.DONE}
    cells = results.table(Table.CELLS, columns=["campaign", "run_id"]).to_pandas().astype(str)
    held = cells[cells["run_id"].isin(done)].groupby("campaign")["run_id"].nunique()
    counts = {campaign: (int(held.get(campaign, 0)), count) for campaign, count in planned.items()}
    short = {campaign: pair for campaign, pair in counts.items() if pair[0] < pair[1]}
    return "; ".join(f"{name} has {held} of {planned:,} runs" for name, (held, planned) in short.items())

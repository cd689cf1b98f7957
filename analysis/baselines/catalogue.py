"""Baselines: lookup by name or location, manifests, and joint reading of several sources."""

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, Self, TypeAlias

import pandas as pd

from analysis.data.frames import Frames
from analysis.data.loading import frames_of, joined, load
from analysis.data.reference import is_baseline, published_frame
from tma_ray.benchmark import SIZES, Tier
from tma_ray.results import SIMULATED, Results, ResultsRootError, Store, check_path
from tma_ray.support.component_names import nearest
from tma_ray.support.decoding import DamagedFileError, Natural, Sha256, decode_json
from tma_ray.support.quantities import expanded
from tma_ray.support.validation import check_type

BASELINE_FILE: Final = "baseline.json"
FORMAT: Final = "tma_ray baseline"
FORMAT_VERSION: Final = 1


class BaselineError(ValueError):
    """Missing or unusable baseline."""


class BaselineKind(StrEnum):
    """Kind of baseline: runs, or published results only."""

    RUNS = "runs"
    """Tables of a results root."""
    PUBLISHED = "published"
    """Published means and standard deviations, without runs."""


@dataclass(frozen=True)
class BaselineFile:
    """Path, size and checksum of a file of a baseline.

    Attributes:
        path: path relative to the baseline's folder.
        size: size in bytes.
        sha256: SHA-256 of the content, hexadecimal.
    """

    path: str
    size: Natural
    sha256: Sha256

    def __post_init__(self) -> None:
        check_path(self.path)

    @classmethod
    def of(cls, store: Store, path: str) -> Self:
        """Return the path, size and checksum of the file at `path`."""
        data = store.read_bytes(path)
        return cls(path, len(data), hashlib.sha256(data).hexdigest())


@dataclass(frozen=True)
class About:
    """Facts about a release that cannot be read from its runs.

    Attributes:
        core: campaigns that ``tma-ray campaign --like`` repeats; empty for those of the previous manifest, or
            all.
        gaps: text about planned campaigns that have not begun; empty for that of the previous manifest.
        budget_note: sentence about rankings at longer budgets; empty for that of the previous manifest.
        trial_cells: default cells of trials, as ``challenge`` or ``challenge/body``; empty for those of the
            previous manifest, or all.
    """

    core: tuple[str, ...] = ()
    gaps: str = ""
    budget_note: str = ""
    trial_cells: tuple[str, ...] = ()


DEFAULT_ABOUT: Final = About()


@dataclass(frozen=True)
class BaselineManifest:
    """Manifest of a baseline: content, origin and files.

    Attributes:
        name: name of the baseline.
        kind: kind of its tables.
        schema_version: schema version of its tables.
        engine: simulator of its worlds.
        physics_versions: versions of tma_ray's physics among its runs; empty for other engines.
        licence: SPDX identifier or text; empty for none.
        created: time of creation, ISO 8601.
        software: program and version that created it.
        partial: text about missing runs; empty if no run is missing.
        caveats: further limits of the results.
        holds: values of each column of the cells, and counts, by name.
        files: all other files in the folder.
        benchmark_versions: versions of the benchmark among its runs, ascending; 0 for older runs.
        core: campaigns that ``tma-ray campaign --like`` repeats, whose teachers are a family of comparisons;
            empty for all.
        planned: planned number of runs by campaign, for a release that grows by shards.
        done: number of finished runs of these campaigns.
        gaps: text about planned campaigns that have not begun; empty for none.
        budget_note: sentence about the agreement of its rankings with those at longer budgets, shown with
            its leaderboards; empty if unknown.
        trial_cells: default cells of trials, named as by `reference.random_cells`; empty for all.
    """

    name: str
    kind: BaselineKind
    schema_version: Natural
    engine: str
    physics_versions: tuple[Natural, ...]
    licence: str
    created: str
    software: str
    partial: str = ""
    caveats: tuple[str, ...] = ()
    holds: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[BaselineFile, ...] = ()
    benchmark_versions: tuple[int, ...] = ()
    core: tuple[str, ...] = ()
    planned: Mapping[str, Natural] = field(default_factory=dict)
    done: Mapping[str, Natural] = field(default_factory=dict)
    gaps: str = ""
    budget_note: str = ""
    trial_cells: tuple[str, ...] = ()

    @property
    def citation(self) -> str:
        """Citation with the name, software and creation date of the baseline."""
        return f"{self.name}, made with {self.software} on {self.created[:10]}."

    @property
    def core_is_whole(self) -> bool:
        """True if no run of the core campaigns is missing."""
        whole = {name for name, count in self.planned.items() if self.done.get(name, 0) >= count}
        return not self.partial or (bool(self.core) and whole.issuperset(self.core))

    def to_bytes(self) -> bytes:
        """Return the manifest as JSON, the content of `BASELINE_FILE`."""
        content = {"format": FORMAT, "format_version": FORMAT_VERSION, **asdict(self)}
        return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()

    @classmethod
    def load(cls, store: Store) -> Self:
        """Return the manifest of the baseline in `store`.

        Raises:
            BaselineError: if there is none, or it is damaged or of another version.
        """
        where = store.where(BASELINE_FILE)
        try:
            data = store.read_bytes(BASELINE_FILE)
            content = decode_json(data, dict[str, Any], where)
            kind = content.get("format"), content.get("format_version")
            if kind != (FORMAT, FORMAT_VERSION):
                raise BaselineError(
                    f"{where} is {kind[0]!r} of version {kind[1]}; expected {FORMAT!r} of version "
                    f"{FORMAT_VERSION}"
                )
            return decode_json(data, cls, where)
        except FileNotFoundError:
            raise BaselineError(f"{store} is not a baseline: {BASELINE_FILE} is missing") from None
        except DamagedFileError as error:
            raise BaselineError(str(error)) from error


SHIPPED: Final = Path(__file__).parent  # folder of the baselines shipped with the package

BASELINES_VARIABLE: Final = "TMA_BASELINES"
"""Environment variable that lists baselines and folders of baselines, separated as in PATH."""


@dataclass(frozen=True)
class Baseline:
    """Baseline: results to compare with, in a folder or an object store.

    Attributes:
        location: folder, or address in an object store.
        manifest: manifest of the baseline.
    """

    location: str
    manifest: BaselineManifest

    @classmethod
    def open(cls, location: str | Path) -> "Baseline":
        """Open the baseline in a folder or at an ``s3://`` or ``gs://`` address.

        Raises:
            BaselineError: if there is none.
        """
        return cls(str(location), BaselineManifest.load(Store.open(location)))

    def frames(self) -> Frames:
        """Return the runs of the baseline.

        Raises:
            BaselineError: if it has only published results.
        """
        if self.manifest.kind is not BaselineKind.RUNS:
            raise BaselineError(f"{self.manifest.name} has no runs, only published results; use published()")
        frames = frames_of(Results(self.store())).with_core(self.manifest.core)
        return replace(frames, cells=frames.cells.assign(budget_note=self.manifest.budget_note))

    def published(self) -> pd.DataFrame:
        """Return the published results, with the columns of `reference.paper_frame`.

        Raises:
            BaselineError: if it has runs instead.
        """
        if self.manifest.kind is not BaselineKind.PUBLISHED:
            raise BaselineError(f"{self.manifest.name} has runs, and no published results; use frames()")
        return published_frame(self.store())

    def store(self) -> Store:
        """Return the store of the baseline's files; a remote store verifies their checksums."""
        store = Store.open(self.location)
        recorded = {file.path: file.sha256 for file in self.manifest.files}
        return store.recorded(recorded) if "://" in self.location else store


def baselines() -> tuple[Baseline, ...]:
    """Return the baselines that are shipped with the package or listed in `BASELINES_VARIABLE`.

    Raises:
        BaselineError: if a location in `BASELINES_VARIABLE` has none, or one is damaged.
    """
    locations = [str(path.parent) for path in SHIPPED.glob(f"*/{BASELINE_FILE}")]
    for entry in re.split(rf"{re.escape(os.pathsep)}(?!//)", os.environ.get(BASELINES_VARIABLE, "")):
        if entry:
            locations += _within(entry)
    opened = map(Baseline.open, dict.fromkeys(locations))
    return tuple(sorted(opened, key=lambda baseline: baseline.manifest.name))


def newest_release() -> Baseline:
    """Return the newest of `baselines` with a complete core of real students at the budgets of tier `lite`.

    Raises:
        BaselineError: if there is none, or a baseline is damaged.
    """
    budgets = set(SIZES[Tier.LITE].steps.values())
    releases = [
        baseline
        for baseline in baselines()
        if baseline.manifest.kind is BaselineKind.RUNS
        and baseline.manifest.engine != SIMULATED
        and baseline.manifest.core_is_whole
        and budgets.issuperset(baseline.manifest.holds["steps"])
    ]
    if not releases:
        raise BaselineError(
            "no release of real students with a complete core and the budgets of tier lite has a name here: "
            "give one with --against"
        )
    return max(releases, key=lambda baseline: baseline.manifest.created)


def find_baseline(name: str | Path) -> Baseline:
    """Return the baseline with the given name, folder or address.

    Raises:
        BaselineError: if there is none, or several have the name.
    """
    text = str(name)
    if "://" in text or expanded(text).exists():
        return Baseline.open(text)
    named = baselines()
    matches = [baseline for baseline in named if baseline.manifest.name == text]
    if len(matches) == 1:
        return matches[0]
    if matches:
        places = ", ".join(baseline.location for baseline in matches)
        raise BaselineError(
            f"{len(matches)} baselines are called {text!r}: give one of their places, {places}"
        )
    names = [baseline.manifest.name for baseline in named]
    raise BaselineError(
        f"no baseline {text!r}: {nearest(text, names)}known: {', '.join(names)}; more "
        f"can lie in folders that {BASELINES_VARIABLE} names, and any other is found by its folder or address"
    )


def as_baseline(root: str | Path) -> Baseline | None:
    """Return the baseline with the given name, folder or address, or None if `root` is a results root.

    Raises:
        BaselineError: if the baseline is damaged.
        ResultsRootError: if a name belongs to neither a folder nor a baseline.
        TypeError: if `root` is neither a string nor a path.
    """
    check_type("root", root, (str, Path), "a folder or an address")
    text = str(root)
    if "://" in text or expanded(text).exists():
        return Baseline.open(text) if Store.open(text).holds(BASELINE_FILE) else None
    names = [baseline.manifest.name for baseline in baselines()]
    if text in names:
        return find_baseline(text)
    if Path(text).name != text:
        return None
    raise ResultsRootError(
        f"{text!r} is not a results root, nor the name of a baseline: {nearest(text, names)}known baselines: "
        f"{', '.join(names)}; give the folder or address that was passed to --results"
    )


def _within(entry: str) -> Iterator[str]:
    """Yield `entry` if it is a baseline, else the locations of all baselines directly below it."""
    store = Store.open(entry)
    if store.holds(BASELINE_FILE):
        yield entry
        return
    if "://" in entry:
        below = [path for path in store.files() if path.count("/") == 1]
    else:
        folder = expanded(entry)
        below = [f"{path.parent.name}/{path.name}" for path in folder.glob(f"*/{BASELINE_FILE}")]
    names = sorted(path.split("/")[0] for path in below if path.endswith(f"/{BASELINE_FILE}"))
    if not names:
        raise BaselineError(f"{BASELINES_VARIABLE} names {entry}, where no baseline lies")
    yield from (f"{entry.rstrip('/')}/{name}" for name in names)


Sources: TypeAlias = str | Path | Sequence[str | Path]
"""Results roots or baselines: folders, ``s3://`` or ``gs://`` addresses, names of baselines."""


def read(sources: Sources) -> Frames:
    """Return the runs of one or several sources, joined as if from one root.

    Raises:
        BaselineError: as in `read_source`.
        ResultsRootError: as in `read_source`.
    """
    return joined([read_source(source) for source in source_list(sources)])


def source_list(sources: Sources) -> tuple[str | Path, ...]:
    """Return one or several sources as a tuple without duplicates.

    Raises:
        ValueError: if there is none.
    """
    distinct = (sources,) if isinstance(sources, str | Path) else tuple(dict.fromkeys(sources))
    if not distinct:
        raise ValueError("no results: expected at least one results root or name of a baseline")
    return distinct


def own_teachers(sources: Sources, frames: Frames) -> frozenset[str]:
    """Return the teachers, except Random, in results roots; empty unless `sources` has baselines, too."""
    distinct = source_list(sources)
    roots = [source for source in distinct if as_baseline(source) is None]
    if not 0 < len(roots) < len(distinct):
        return frozenset()
    run_ids = {run_id for root in roots for run_id in load(root).cells["run_id"]}
    teachers = frames.cells.loc[frames.cells["run_id"].isin(run_ids), "teacher"].unique()
    return frozenset(str(teacher) for teacher in teachers if not is_baseline(str(teacher)))


def published(sources: Sources) -> Baseline | None:
    """Return the baseline if `sources` is a single baseline with published results, else None."""
    distinct = source_list(sources)
    baseline = as_baseline(distinct[0]) if len(distinct) == 1 else None
    return baseline if baseline and baseline.manifest.kind is BaselineKind.PUBLISHED else None


def read_source(source: str | Path) -> Frames:
    """Return the runs of a results root or a baseline.

    Raises:
        BaselineError: if a baseline is damaged, or has only published results.
        ResultsRootError: if the root or baseline is missing.
    """
    baseline = as_baseline(source)
    if baseline and baseline.manifest.kind is BaselineKind.PUBLISHED:
        raise BaselineError(
            f"{source} has published means and deviations only, and no runs to pool or to test with: set it "
            f"next to yours with tma-ray compare, or ask for its tables and figures alone"
        )
    return baseline.frames() if baseline else load(source)

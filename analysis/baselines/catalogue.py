"""Baselines by name or place, their manifests, and sources of results that are read as one."""

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, Self, TypeAlias

import pandas as pd

from analysis.data.frames import Frames, frames_of, joined, load
from analysis.data.reference import is_baseline, published_frame
from tma_ray.results import SIMULATED, Results, ResultsRootError, Store, check_path
from tma_ray.support.component_names import nearest
from tma_ray.support.decoding import DamagedFileError, Natural, Sha256, decode_json
from tma_ray.support.quantities import expanded
from tma_ray.support.validation import check_type

BASELINE_FILE: Final = "baseline.json"
FORMAT: Final = "tma_ray baseline"
FORMAT_VERSION: Final = 1


class BaselineError(ValueError):
    """Missing or unusable baseline; the message says why and what to do."""


class BaselineKind(StrEnum):
    """Kind of the tables of a baseline."""

    RUNS = "runs"
    """Those of a results root: every evaluation and episode of every run."""
    PUBLISHED = "published"
    """Means and deviations that somebody published: without runs to pool or to test with."""


@dataclass(frozen=True)
class BaselineFile:
    """One file of a baseline.

    Attributes:
        path: path from the baseline's folder.
        size: bytes.
        sha256: SHA-256 of its bytes, hexadecimal.
    """

    path: str
    size: Natural
    sha256: Sha256

    def __post_init__(self) -> None:
        check_path(self.path)

    @classmethod
    def of(cls, store: Store, path: str) -> Self:
        """Return path, size and checksum of the file at `path`."""
        data = store.read_bytes(path)
        return cls(path, len(data), hashlib.sha256(data).hexdigest())


@dataclass(frozen=True)
class About:
    """Facts about a release that its runs do not contain.

    Attributes:
        core: campaigns that ``tma-ray campaign --like`` repeats; empty for what the release has, or all.
        gaps: campaigns that it is to have and that have not begun, in words; empty for what the release has.
    """

    core: tuple[str, ...] = ()
    gaps: str = ""


UNSAID: Final = About()


@dataclass(frozen=True)
class BaselineManifest:
    """Manifest of a baseline: content, origin and files.

    Attributes:
        name: name of the baseline.
        kind: kind of its tables.
        schema_version: schema version of its tables.
        engine: simulator of its worlds.
        physics_versions: versions of tma_ray's physics among its runs; empty for other engines.
        licence: terms under which others may use it, an SPDX identifier or words; empty if none are given.
        created: time at which it was made, ISO 8601.
        software: program that made it, with its version.
        partial: runs that are missing of its campaigns, in words; empty if none are.
        caveats: further limits of its results.
        holds: values of each column of its cells, and counts, by name.
        files: all other files in its folder.
        benchmark_versions: versions of the benchmark among its runs, rising; 0 for older runs.
        core: campaigns that ``tma-ray campaign --like`` repeats, and whose teachers are compared in a family
            of their own; empty for all of them.
        planned: runs that each campaign was to have, by its name, of a release that grows by shards.
        done: runs that each of these campaigns has.
        gaps: campaigns that it is to have and that have not begun, in words; empty if nobody named any.
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

    @property
    def citation(self) -> str:
        """Default citation, for releases whose authors give none."""
        return f"{self.name}, made with {self.software} on {self.created[:10]}."

    @property
    def core_is_whole(self) -> bool:
        """True if no run of its core is missing, though other campaigns may still grow."""
        whole = {name for name, count in self.planned.items() if self.done.get(name, 0) >= count}
        return not self.partial or (bool(self.core) and whole.issuperset(self.core))

    def to_bytes(self) -> bytes:
        """Return the content of `BASELINE_FILE`."""
        content = {"format": FORMAT, "format_version": FORMAT_VERSION, **asdict(self)}
        return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()

    @classmethod
    def load(cls, store: Store) -> Self:
        """Return the manifest of the baseline in `store`.

        Raises:
            BaselineError: not a baseline, a damaged one, or one of another version.
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


SHIPPED: Final = Path(__file__).parent
"""Where the baselines of the package lie."""

PLACES_VARIABLE: Final = "TMA_BASELINES"
"""Environment variable: baselines, and folders of baselines, separated as in PATH."""


@dataclass(frozen=True)
class Baseline:
    """Results to compare with, in a folder or at an address.

    Attributes:
        place: folder, or address in an object store.
        manifest: manifest of the baseline.
    """

    place: str
    manifest: BaselineManifest

    @classmethod
    def open(cls, place: str | Path) -> "Baseline":
        """Return the baseline at a folder or an ``s3://`` or ``gs://`` address.

        Raises:
            BaselineError: there is none.
        """
        return cls(str(place), BaselineManifest.load(Store.open(place)))

    def frames(self) -> Frames:
        """Return its runs, as `load` returns those of the root that it was made of.

        Raises:
            BaselineError: it has none, being published means and deviations.
        """
        if self.manifest.kind is not BaselineKind.RUNS:
            raise BaselineError(f"{self.manifest.name} has no runs, only published results; use published()")
        return frames_of(Results(self.store())).with_core(self.manifest.core)

    def published(self) -> pd.DataFrame:
        """Return its published results, in the columns of `reference.paper_frame`.

        Raises:
            BaselineError: it has runs instead.
        """
        if self.manifest.kind is not BaselineKind.PUBLISHED:
            raise BaselineError(f"{self.manifest.name} has runs, and no published results; use frames()")
        return published_frame(self.store())

    def store(self) -> Store:
        """Return the store of its files; at an address, each file's checksum is checked before use."""
        store = Store.open(self.place)
        recorded = {file.path: file.sha256 for file in self.manifest.files}
        return store.recorded(recorded) if "://" in self.place else store


def baselines() -> tuple[Baseline, ...]:
    """Return the baselines that are known by name.

    Raises:
        BaselineError: `PLACES_VARIABLE` names a place without any, or one is damaged.
    """
    places = [str(path.parent) for path in SHIPPED.glob(f"*/{BASELINE_FILE}")]
    for entry in re.split(rf"{re.escape(os.pathsep)}(?!//)", os.environ.get(PLACES_VARIABLE, "")):
        if entry:
            places += _within(entry)
    return tuple(sorted(map(Baseline.open, dict.fromkeys(places)), key=lambda each: each.manifest.name))


def newest_release() -> Baseline:
    """Return the newest known release that has runs of real students and a whole core.

    Raises:
        BaselineError: there is none, or a baseline is damaged.
    """
    found = [
        each
        for each in baselines()
        if each.manifest.kind is BaselineKind.RUNS
        and each.manifest.engine != SIMULATED
        and each.manifest.core_is_whole
    ]
    if not found:
        raise BaselineError(
            "no release of real students with a whole core has a name here: give one with --against"
        )
    return max(found, key=lambda each: each.manifest.created)


def find_baseline(name: str | Path) -> Baseline:
    """Return the baseline of a name, or the one at a folder or address.

    Raises:
        BaselineError: there is none, or several have the name.
    """
    text = str(name)
    if "://" in text or expanded(text).exists():
        return Baseline.open(text)
    known = baselines()
    found = [each for each in known if each.manifest.name == text]
    if len(found) == 1:
        return found[0]
    if found:
        places = ", ".join(each.place for each in found)
        raise BaselineError(f"{len(found)} baselines are called {text!r}: give one of their places, {places}")
    names = [each.manifest.name for each in known]
    raise BaselineError(
        f"no baseline {text!r}: {nearest(text, names)}known: {', '.join(names)}; more "
        f"can lie in folders that {PLACES_VARIABLE} names, and any other is found by its folder or address"
    )


def as_baseline(root: str | Path) -> Baseline | None:
    """Return the baseline at or called `root`; None if it is none, as for a results root.

    Raises:
        BaselineError: it is a damaged one.
        ResultsRootError: it is a name, of no folder here and of no baseline.
        TypeError: it is neither text nor a path.
    """
    check_type("root", root, (str, Path), "a folder or an address")
    text = str(root)
    if "://" in text or expanded(text).exists():
        return Baseline.open(text) if Store.open(text).holds(BASELINE_FILE) else None
    names = [each.manifest.name for each in baselines()]
    if text in names:
        return find_baseline(text)
    if Path(text).name != text:
        return None
    raise ResultsRootError(
        f"{text!r} is not a results root, nor the name of a baseline: {nearest(text, names)}known baselines: "
        f"{', '.join(names)}; give the folder or address that was passed to --results"
    )


def _within(entry: str) -> Iterator[str]:
    """Yield the baseline at a place, or those in the folders directly below it."""
    store = Store.open(entry)
    if store.holds(BASELINE_FILE):
        yield entry
        return
    if "://" in entry:
        below = [path for path in store.files() if path.count("/") == 1]
    else:
        folder = expanded(entry)
        below = [f"{path.parent.name}/{path.name}" for path in folder.glob(f"*/{BASELINE_FILE}")]
    found = sorted(path.split("/")[0] for path in below if path.endswith(f"/{BASELINE_FILE}"))
    if not found:
        raise BaselineError(f"{PLACES_VARIABLE} names {entry}, where no baseline lies")
    yield from (f"{entry.rstrip('/')}/{name}" for name in found)


Sources: TypeAlias = str | Path | Sequence[str | Path]
"""Results roots or baselines: folders, ``s3://`` or ``gs://`` addresses, names of baselines."""


def read(sources: Sources) -> Frames:
    """Return the runs of all `sources` together, as if of one root; raises as `read_one`."""
    return joined([read_one(place) for place in places_of(sources)])


def places_of(sources: Sources) -> tuple[str | Path, ...]:
    """Return `sources` one by one, each once.

    Raises:
        ValueError: none is given.
    """
    places = (sources,) if isinstance(sources, str | Path) else tuple(dict.fromkeys(sources))
    if not places:
        raise ValueError("no results: expected at least one results root or name of a baseline")
    return places


def own_teachers(sources: Sources, frames: Frames) -> frozenset[str]:
    """Return the teachers, except Random, of the results roots among the sources that include baselines."""
    places = places_of(sources)
    roots = [place for place in places if as_baseline(place) is None]
    if not 0 < len(roots) < len(places):
        return frozenset()
    run_ids = {run_id for root in roots for run_id in load(root).cells["run_id"]}
    teachers = frames.cells.loc[frames.cells["run_id"].isin(run_ids), "teacher"].unique()
    return frozenset(str(teacher) for teacher in teachers if not is_baseline(str(teacher)))


def published(sources: Sources) -> Baseline | None:
    """Return the baseline of `sources` if it holds published means and deviations; None if it holds runs."""
    places = places_of(sources)
    baseline = as_baseline(places[0]) if len(places) == 1 else None
    return baseline if baseline and baseline.manifest.kind is BaselineKind.PUBLISHED else None


def read_one(place: str | Path) -> Frames:
    """Return the runs of a results root or a baseline.

    Raises:
        BaselineError: a damaged baseline, or one of published means, without runs.
        ResultsRootError: nothing of that name or at that place.
    """
    baseline = as_baseline(place)
    if baseline and baseline.manifest.kind is BaselineKind.PUBLISHED:
        raise BaselineError(
            f"{place} has published means and deviations only, and no runs to pool or to test with: set it "
            f"next to yours with tma-ray compare, or ask for its tables and figures alone"
        )
    return baseline.frames() if baseline else load(place)

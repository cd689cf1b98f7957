"""Baselines by name: those of the package, those of ``TMA_BASELINES``, and any other by its place."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pandas as pd

from analysis.baselines.manifest import BASELINE_FILE, BaselineError, BaselineKind, BaselineManifest
from analysis.data.frames import Frames, frames_of
from analysis.data.published import published_frame
from tma_ray.commands.arguments import check_kind
from tma_ray.commands.places import expanded
from tma_ray.part_names import nearest
from tma_ray.results import RecordedStore, Results, ResultsRootError, Store

SHIPPED: Final = Path(__file__).parent
"""Where the baselines of the package lie."""

PLACES_VARIABLE: Final = "TMA_BASELINES"
"""Environment variable: baselines, and folders of baselines, separated as in PATH."""


@dataclass(frozen=True)
class Baseline:
    """Results to compare with, somewhere.

    Attributes:
        place: folder, or address in an object store.
        manifest: what it says of itself.
    """

    place: str
    manifest: BaselineManifest

    @classmethod
    def open(cls, place: str | Path) -> Baseline:
        """Returns the baseline at a folder or an ``s3://`` or ``gs://`` address.

        Raises:
            BaselineError: there is none.
        """
        return cls(str(place), BaselineManifest.load(Store.open(place)))

    def frames(self) -> Frames:
        """Returns its runs, as `load` returns those of the root that it was made of.

        Raises:
            BaselineError: it has none, being published means and deviations.
        """
        if self.manifest.kind is not BaselineKind.RUNS:
            raise BaselineError(f"{self.manifest.name} has no runs, only published results; use published()")
        return frames_of(Results(self.store()))

    def published(self) -> pd.DataFrame:
        """Returns its published results, in the columns of `published.paper_frame`.

        Raises:
            BaselineError: it has runs instead.
        """
        if self.manifest.kind is not BaselineKind.PUBLISHED:
            raise BaselineError(f"{self.manifest.name} has runs, and no published results; use frames()")
        return published_frame(self.store())

    def store(self) -> Store:
        """Returns its files; at an address all of each is compared with its checksum before it is used."""
        store = Store.open(self.place)
        if "://" not in self.place:
            return store
        return RecordedStore(store, {file.path: file.sha256 for file in self.manifest.files})


def baselines() -> tuple[Baseline, ...]:
    """Returns the baselines that have a name here, by name.

    Raises:
        BaselineError: `PLACES_VARIABLE` names a place without any, or one is damaged.
    """
    places = [str(path.parent) for path in SHIPPED.glob(f"*/{BASELINE_FILE}")]
    for entry in re.split(rf"{re.escape(os.pathsep)}(?!//)", os.environ.get(PLACES_VARIABLE, "")):
        if entry:
            places += _within(entry)
    return tuple(sorted(map(Baseline.open, dict.fromkeys(places)), key=lambda each: each.manifest.name))


def find_baseline(name: str | Path) -> Baseline:
    """Returns the baseline of a name, or the one at a folder or address.

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
    """Returns the baseline that `root` names or is, None if it is none: perhaps a results root.

    Raises:
        BaselineError: it is a damaged one.
        ResultsRootError: it is a name, of no folder here and of no baseline.
        TypeError: it is neither text nor a path.
    """
    check_kind("root", root, (str, Path), "a folder or an address")
    text = str(root)
    if "://" in text or expanded(text).exists():
        return Baseline.open(text) if Store.open(text).exists(BASELINE_FILE) else None
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
    """Yields the baselines at a place: itself, or those just below it."""
    store = Store.open(entry)
    if store.exists(BASELINE_FILE):
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

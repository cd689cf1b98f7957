"""Manifest of a baseline: ``baseline.json`` beside its files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any, Final, Self

from tma_ray.decoding import DamagedFileError, Natural, Sha256, decode_json
from tma_ray.results import Store, check_path

BASELINE_FILE: Final = "baseline.json"
FORMAT: Final = "tma_ray baseline"
FORMAT_VERSION: Final = 1

FOREIGN_FILES: Final = frozenset({".gitattributes"})
"""Files that a place may keep beside those of a baseline: the hub's data sets have one from the start."""


class BaselineError(ValueError):
    """A place that is not a baseline, or one that cannot be used; the message says why and what to do."""


class BaselineKind(StrEnum):
    """What the tables of a baseline are."""

    RUNS = "runs"
    """Those of a results root: every evaluation and episode of every run."""
    PUBLISHED = "published"
    """Means and deviations that somebody published: without runs to pool or to test with."""


@dataclass(frozen=True)
class BaselineFile:
    """One file of a baseline.

    Attributes:
        path: from the baseline's folder.
        size: bytes.
        sha256: of its bytes, hexadecimal.
    """

    path: str
    size: Natural
    sha256: Sha256

    def __post_init__(self) -> None:
        check_path(self.path)

    @classmethod
    def of(cls, store: Store, path: str) -> Self:
        """Returns what the file at `path` is now."""
        data = store.read_bytes(path)
        return cls(path, len(data), hashlib.sha256(data).hexdigest())


@dataclass(frozen=True)
class About:
    """Statements about a release that its runs do not make.

    Attributes:
        core: campaigns that ``tma-ray campaign --like`` repeats; empty for what the release has, or all.
        gaps: campaigns that it is to have and that have not begun, in words; empty for what the release has.
    """

    core: tuple[str, ...] = ()
    gaps: str = ""

    def or_of(self, released: BaselineManifest | None) -> About:
        """Returns these statements, and those of a release where there are none."""
        if released is None:
            return self
        return About(self.core or released.core, self.gaps or released.gaps)


UNSAID: Final = About()


@dataclass(frozen=True)
class _Format:
    """What every version of `BASELINE_FILE` says first."""

    format: str
    format_version: int


@dataclass(frozen=True)
class BaselineManifest:
    """What a baseline is, and of which files it consists.

    Attributes:
        name: what it is called.
        kind: what its tables are.
        schema_version: of its tables.
        engine: what simulated its worlds.
        physics_versions: of tma_ray, of its runs; empty for other engines.
        licence: under which others may use it, an SPDX identifier or words; empty if nobody said.
        created: when it was made, ISO 8601.
        software: what made it, with its version.
        partial: what is missing of the campaigns that it holds; empty if nothing is.
        caveats: what a reader must know besides.
        holds: values of each column of its cells, and counts, by name.
        files: all others in its folder.
        benchmark_versions: of its runs, rising; 0 for those made before there was one.
        core: campaigns that ``tma-ray campaign --like`` repeats; empty for all of them.
        planned: runs that each campaign was to have, by its name, of a release that grows by shards.
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
    gaps: str = ""

    def to_bytes(self) -> bytes:
        """Returns the content of `BASELINE_FILE`."""
        content = {"format": FORMAT, "format_version": FORMAT_VERSION, **asdict(self)}
        return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()

    @classmethod
    def load(cls, store: Store) -> Self:
        """Returns what the baseline in `store` says of itself.

        Raises:
            BaselineError: not a baseline, a damaged one, or one of another version.
        """
        where = store.where(BASELINE_FILE)
        try:
            data = store.read_bytes(BASELINE_FILE)
            kind = decode_json(data, _Format, where)
            if (kind.format, kind.format_version) != (FORMAT, FORMAT_VERSION):
                raise BaselineError(
                    f"{where} is {kind.format!r} of version {kind.format_version}; expected {FORMAT!r} of "
                    f"version {FORMAT_VERSION}"
                )
            return decode_json(data, cls, where)
        except FileNotFoundError:
            raise BaselineError(f"{store} is not a baseline: {BASELINE_FILE} is missing") from None
        except DamagedFileError as error:
            raise BaselineError(str(error)) from error

"""What a baseline says of itself: ``baseline.json`` beside its files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any, Final, Self

from tma_ray.results import Store, check_path

BASELINE_FILE: Final = "baseline.json"
FORMAT: Final = "tma_ray baseline"
FORMAT_VERSION: Final = 1


class BaselineError(ValueError):
    """A place that is no baseline, or one that cannot be used; the message says why and what to do."""


class BaselineKind(StrEnum):
    """What the tables of a baseline are."""

    RUNS = "runs"
    """Those of a results root: every evaluation and episode of every run."""
    PUBLISHED = "published"
    """Means and deviations that somebody published: there are no runs to pool or to test with."""


@dataclass(frozen=True)
class BaselineFile:
    """One file of a baseline.

    Attributes:
        path: from the baseline's folder.
        size: bytes.
        sha256: of its bytes, hexadecimal.
    """

    path: str
    size: int
    sha256: str

    @classmethod
    def of(cls, store: Store, path: str) -> Self:
        """Returns what the file at `path` is now."""
        data = store.read_bytes(path)
        return cls(path, len(data), hashlib.sha256(data).hexdigest())


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
    """

    name: str
    kind: BaselineKind
    schema_version: int
    engine: str
    physics_versions: tuple[int, ...]
    licence: str
    created: str
    software: str
    partial: str = ""
    caveats: tuple[str, ...] = ()
    holds: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[BaselineFile, ...] = ()
    benchmark_versions: tuple[int, ...] = ()

    def to_bytes(self) -> bytes:
        """Returns the content of `BASELINE_FILE`."""
        content = {"format": FORMAT, "format_version": FORMAT_VERSION, **asdict(self)}
        return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()

    @classmethod
    def load(cls, store: Store) -> Self:
        """Returns what the baseline in `store` says of itself.

        Raises:
            BaselineError: there is no baseline, a damaged one, or one of another version.
        """
        where = store.where(BASELINE_FILE)
        try:
            content = json.loads(store.read_bytes(BASELINE_FILE))
            known = content.pop("format"), content.pop("format_version")
            if known != (FORMAT, FORMAT_VERSION):
                raise BaselineError(
                    f"{where} is {known[0]!r} of version {known[1]!r}; expected {FORMAT!r} of version 1"
                )
            content["kind"] = BaselineKind(content["kind"])
            for name in ("physics_versions", "caveats", "benchmark_versions"):
                content[name] = tuple(content.get(name, ()))
            content["files"] = tuple(BaselineFile(**file) for file in content["files"])
            for file in content["files"]:
                check_path(file.path)
            return cls(**content)
        except FileNotFoundError:
            raise BaselineError(f"{store} is not a baseline: {BASELINE_FILE} is missing") from None
        except BaselineError:
            raise
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise BaselineError(f"{where} is damaged: {error}") from error

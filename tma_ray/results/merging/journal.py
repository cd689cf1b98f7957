"""The journal of a compaction: files that it leaves without use."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import asdict, dataclass
from pathlib import PurePosixPath
from typing import Final

from tma_ray.decoding import DamagedFileError, DamagedFileWarning, decode_json
from tma_ray.results.layout import TABLES, check_path
from tma_ray.results.reader import Results
from tma_ray.results.storage.store import Store

JOURNAL: Final = "compacting.json"
"""Lists what a compaction leaves without use: files that it replaces, or its own if it is interrupted."""

_MERGED: Final = re.compile(rf"{TABLES}/[^/]+/[^/]+\.parquet")


@dataclass(frozen=True)
class Journal:
    """Files to delete in the end, by this call or, if it is killed, by the next.

    Attributes:
        unless_used: files that go if no manifest lists them.
        replaced: files that go in any case.
    """

    unless_used: tuple[str, ...] = ()
    replaced: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for path in (*self.unless_used, *self.replaced):
            if not _MERGED.fullmatch(check_path(path)):
                raise ValueError(
                    f"path {path!r}: expected a file of a table, as in {TABLES}/runs/NAME.parquet"
                )

    @classmethod
    def load(cls, store: Store) -> Journal:
        """Returns the journal of a root; an empty one if there is none, or one that cannot be read."""
        try:
            return decode_json(store.read_bytes(JOURNAL), cls, store.where(JOURNAL))
        except FileNotFoundError:
            return cls()
        except DamagedFileError as error:  # what it listed stays, and no reader looks at it
            warnings.warn(str(error), DamagedFileWarning, stacklevel=2)
            return cls()

    def write(self, store: Store) -> None:
        """Replaces the journal of a root by this one."""
        content = Journal(tuple(sorted(set(self.unless_used))), self.replaced)
        store.write_bytes(JOURNAL, json.dumps(asdict(content)).encode())


def clean(store: Store) -> None:
    """Deletes what the journal lists and no manifest needs.

    While a manifest cannot be read, what it may list stays: all but files of runs whose manifests can.
    """
    if not store.exists(JOURNAL):
        return
    journal, results = Journal.load(store), Results(store)
    used = {file.path for manifest in results.runs() for file in manifest.files}
    known = {manifest.run.run_id for manifest in results.runs()}
    unused = [path for path in journal.unless_used if path not in used]
    doubtful = [path for path in unused if results.problems and not _is_of(path, known)]
    for path in (*(path for path in unused if path not in doubtful), *journal.replaced):
        store.delete(path)
    if doubtful:
        Journal(tuple(doubtful)).write(store)
    else:
        store.delete(JOURNAL)


def _is_of(path: str, run_ids: set[str]) -> bool:
    """Tells whether a file is one of these runs' alone."""
    place = PurePosixPath(path)
    return not run_ids.isdisjoint((*place.parts, place.stem))

"""Layout of a results root: its paths, and the file that marks a folder as a root."""

import re
import warnings
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Final

import pyarrow as pa

from tma_ray.results.schema import SCHEMA_VERSION, Table, schema_version
from tma_ray.results.storage import ResultsRootError, Store
from tma_ray.results.storage.base import TEMPORARY
from tma_ray.support.decoding import DamagedFileError, DamagedFileWarning, Natural
from tma_ray.support.validation import check_type

FORMAT: Final = "tma_ray results"
ROOT_FILE: Final = "root.json"
LEASE_FILE: Final = "lease.json"
STOP_FILE: Final = "stop.json"
HEARTBEAT_FILE: Final = "heartbeat.json"
MANIFESTS: Final = "manifests"
INDEX_FILE: Final = "manifests.jsonl.gz"
"""Manifests of a release, one per line. Files in `MANIFESTS` take precedence."""
STAGING: Final = "staging"
TABLES: Final = "tables"
CHECKPOINTS: Final = "checkpoints"
POLICIES: Final = "policies"
LOGS: Final = "logs"
INPUTS: Final = "inputs"

FOLDERS: Final = (TEMPORARY, MANIFESTS, STAGING, TABLES, CHECKPOINTS, POLICIES, LOGS, INPUTS)
"""Folders that campaigns write to."""

LONGEST_ID: Final = 200  # largest number of characters in an id, since ids are parts of file names

_ID: Final = re.compile(rf"[0-9a-zA-Z_-]{{1,{LONGEST_ID}}}")


@dataclass(frozen=True)
class RootFile:
    """Content of `ROOT_FILE`."""

    format: str
    schema_version: Natural


def check_usable(store: Store) -> None:
    """Check that a store is a results root of this version or can become one, and is writable.

    Errors are those of `create_root` and `Store.check_access`.
    """
    store.check_access()
    _check_content(store)


def _check_content(store: Store) -> None:
    store.check_location(*FOLDERS)
    if store.exists(ROOT_FILE) or _version_of_tables(store) is not None:
        check_root(store)
        return
    foreign = [name for name in sorted(store.names()) if name != TEMPORARY or store.exists(name)]
    inner = (f"{TEMPORARY}/{name}" for name in sorted(store.names(TEMPORARY)))
    foreign += [path for path in inner if not store.is_temporary(path)]
    if foreign:
        raise ResultsRootError(
            f"{store} is neither empty ({foreign[0]}) nor a results root; choose a new or empty folder"
        )


def create_root(store: Store) -> None:
    """Turn an empty store into a results root, or add a missing `ROOT_FILE` to a root of this version.

    Raises:
        ResultsRootError: if it holds something else, or a root of another version.
        DamagedFileError: if a link leads out of the root.
    """
    _check_content(store)
    content = RootFile(FORMAT, SCHEMA_VERSION)
    if _root_file(store) != content:
        store.write_json(ROOT_FILE, content, indent=1)


def check_root(store: Store) -> None:
    """Check that a store is a results root of this version, judged by its tables if `ROOT_FILE` is missing.

    Raises:
        ResultsRootError: if it is not a results root, or one of another version.
        TypeError: if `store` is not a store.
    """
    check_type("store", store, Store, "a Store, as Store.open('results')")
    content = _root_file(store)
    if content is None or isinstance(content, DamagedFileError):
        version = _version_of_tables(store)
        if version is None:
            if content is not None:
                raise ResultsRootError(f"{content}; no table tells its version either") from content
            store.check_listable()
            raise ResultsRootError(
                f"{store} is not a results root: {ROOT_FILE} is missing; give the folder or address that was "
                f"passed to --results"
            )
        problem = content or f"{store.where(ROOT_FILE)} is missing"
        warnings.warn(f"{problem}; its tables are of version {version}", DamagedFileWarning, stacklevel=2)
        content = RootFile(FORMAT, version)
    if content.format != FORMAT:
        raise ResultsRootError(f"{store.where(ROOT_FILE)} is of format {content.format!r}, not {FORMAT!r}")
    if content.schema_version != SCHEMA_VERSION:
        raise ResultsRootError(
            f"{store} has schema version {content.schema_version}; this tma_ray reads and writes version "
            f"{SCHEMA_VERSION}. Use the tma_ray that wrote it, or another root"
        )


def _root_file(store: Store) -> RootFile | DamagedFileError | None:
    try:
        return store.read_json(ROOT_FILE, RootFile)
    except FileNotFoundError:
        return None
    except DamagedFileError as error:
        return error


def _version_of_tables(store: Store) -> int | None:
    """Return the schema version in the files of the table of runs, or None if none is readable."""
    for path in store.files(f"{TABLES}/{Table.RUNS}"):
        try:
            return store.read_parts(path, schema_version)
        except (OSError, ValueError, KeyError, pa.ArrowException):
            continue
    return None


def is_id(name: str) -> bool:
    """Return True if `name` is a valid id: up to `LONGEST_ID` letters, digits, "_" and "-"."""
    return _ID.fullmatch(name) is not None


def check_id(name: str) -> str:
    """Return `name` if it is a valid id, or raise a ValueError."""
    if not is_id(name):
        raise ValueError(
            f"id {name!r:.60} is part of file names: use up to {LONGEST_ID} letters, digits, '_' and '-'"
        )
    return name


def check_path(path: str) -> str:
    """Return `path` if it is relative and has no "..", backslash or empty part, or raise a ValueError."""
    if any(part in ("", ".", "..") or "\\" in part for part in path.split("/")):
        raise ValueError(f"path {path!r} may lead out of its folder: expected names, separated by '/'")
    return path


def manifest_path(run_id: str) -> str:
    """Return the path of a run's manifest."""
    return f"{MANIFESTS}/{check_id(run_id)}.json"


def staging_folder(run_id: str) -> str:
    """Return the folder that holds the parts of all attempts at a run."""
    return f"{STAGING}/{check_id(run_id)}"


def part_path(run_id: str, attempt: int, part: int, table: Table) -> str:
    """Return the path of a table's rows in one part of an attempt."""
    return f"{staging_folder(run_id)}/attempt-{attempt:03d}/part-{part:05d}/{table}.parquet"


def part_number(path: str) -> int:
    """Return the number of the part at `path`."""
    return int(PurePosixPath(path).parent.name.removeprefix("part-"))


def progress_path(run_id: str, attempt: int) -> str:
    """Return the path of the record of a running attempt."""
    return f"{staging_folder(run_id)}/attempt-{attempt:03d}/attempt.json"


def final_path(run_id: str, attempt: int, table: Table) -> str:
    """Return the path of a canonical file before its publication."""
    return f"{staging_folder(run_id)}/attempt-{attempt:03d}/final/{table}.parquet"


def staged_policy(run_id: str, attempt: int) -> str:
    """Return the folder of an attempt's final policy before its publication."""
    return f"{staging_folder(run_id)}/attempt-{attempt:03d}/policy"


def policy_folder(run_id: str) -> str:
    """Return the folder of a run's published policy."""
    return f"{POLICIES}/{check_id(run_id)}"


def log_path(run_id: str, attempt: int) -> str:
    """Return the path of an attempt's log."""
    return f"{LOGS}/{check_id(run_id)}/attempt-{attempt:03d}.log"


def table_path(table: Table, name: str) -> str:
    """Return the path of a table's file, named after a run or, for the table of cells, a campaign."""
    return f"{TABLES}/{table}/{check_id(name)}.parquet"

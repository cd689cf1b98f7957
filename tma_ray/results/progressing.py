"""Records of attempts under way: what is known of one whose driver died with it."""

from __future__ import annotations

import json
from dataclasses import asdict
from datetime import UTC, datetime

from tma_ray.decoding import DamagedFileError, decode_json
from tma_ray.results.layout import manifest_path, progress_path
from tma_ray.results.records import AttemptOutcome, AttemptRecord
from tma_ray.results.storage.store import Store


def write_progress(store: Store, record: AttemptRecord) -> None:
    """Keeps the record of an attempt under way, as if it were lost now, beside its parts."""
    content = {**asdict(record), "started_at": record.started_at.isoformat()}
    store.write_bytes(progress_path(record.run_id, record.attempt), json.dumps(content).encode())


def read_progress(store: Store, run_id: str, attempt: int) -> AttemptRecord | None:
    """Returns the last record that an attempt has kept, None if there is none that can be read."""
    path = progress_path(run_id, attempt)
    try:
        record = decode_json(store.read_bytes(path), AttemptRecord, store.where(path))
    except (FileNotFoundError, DamagedFileError):
        return None
    return record if (record.run_id, record.attempt) == (run_id, attempt) else None


def unheard(store: Store, run_id: str, attempt: int) -> AttemptRecord:
    """Returns the record of a published attempt that kept none.

    It has published nothing but its number, so that the run's manifest tells when it was started.
    """
    started_at = store.modified_at(manifest_path(run_id)) or datetime.now(UTC)
    return AttemptRecord(run_id, attempt, started_at, 0.0, 0.0, "", "{}", AttemptOutcome.LOST)

"""Export of runs' scalars to TensorBoard event files, written by tensorboardX."""

import re
import struct
import time
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from analysis.tracking.points import TRACKED_TABLES, Point, Tracker
from tma_ray.results import Manifest, RunRecord, RunStatus, Table
from tma_ray.support.decoding import read_file
from tma_ray.support.quantities import expanded

_NAMES: Final = "events.out.tfevents.*"

_LENGTH: Final = struct.Struct("<Q")
"""Header of a record: its size in bytes. Header and record are each followed by a checksum of 4 bytes."""


def event_files(folder: Path) -> list[Path]:
    """Return the event files in a folder, except symbolic links, in TensorBoard's order."""
    return sorted(path for path in folder.glob(_NAMES) if not path.is_symlink())


def read_scalars(files: Sequence[Path]) -> dict[str, deque[tuple[int, float]]]:
    """Return the steps and values of every tag, reading each file up to its first incomplete record."""
    from google.protobuf.message import DecodeError
    from tensorboardX.proto.event_pb2 import Event

    scalars: dict[str, deque[tuple[int, float]]] = defaultdict(deque)
    for file in files:
        try:
            for record in _records(read_file(file)):
                event = Event.FromString(record)
                for value in event.summary.value:
                    scalars[value.tag].append((event.step, value.simple_value))
        except DecodeError:
            continue
    return scalars


def _records(content: bytes) -> Iterator[bytes]:
    start = _LENGTH.size + 4
    while start <= len(content):
        end = start + _LENGTH.unpack_from(content, start - 4 - _LENGTH.size)[0]
        if end + 4 > len(content):
            return
        yield content[start:end]
        start = end + 4 + _LENGTH.size + 4


class RunEvents:
    """Event files of a run, in a folder that TensorBoard may be reading.

    Unlike tensorboardX's ``SummaryWriter``, this needs no thread and queue for every file.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._counts: dict[Table, int] = {}  # points written so far, by table
        self._writer: Any = None  # writer of the current file
        self._opened = 0  # number of files opened, to distinguish files created in the same second
        self._cleared = False  # True after emptying earlier files, until the next one is opened

    def append(self, points: Mapping[Table, Sequence[Point]]) -> bool:
        """Write the new points, or all points if some were withdrawn, and return True if any were written."""
        if not self._counts:  # an earlier tracker may have written some points
            files = event_files(self._folder)
            written, self._opened = read_scalars(files), len(files)
            self._counts = {table: _common(points[table], written) for table in TRACKED_TABLES}
            if any(written.values()):
                self._clear()
        elif any(len(points[table]) < count for table, count in self._counts.items()):
            self._clear()
        new = [point for table in TRACKED_TABLES for point in points[table][self._counts.get(table, 0) :]]
        self._counts = {table: len(points[table]) for table in TRACKED_TABLES}
        if new:
            self._write(sorted(new, key=lambda point: point[0]))
        return bool(new)

    def _write(self, points: Iterable[Point]) -> None:
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto.event_pb2 import Event

        if self._writer is None:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._writer = EventsWriter(str(self._folder / "events"), f".{self._opened}")
            self._opened += 1
            if self._cleared:  # a running TensorBoard discards earlier points at START
                start = Event(wall_time=time.time(), step=0)
                start.session_log.status = start.session_log.START
                self._writer.write_event(start)
                self._cleared = False
        for step, scalars in points:
            if scalars:
                event = Event(wall_time=time.time(), step=step)
                for tag, value in scalars.items():
                    event.summary.value.add(tag=tag, simple_value=value)
                self._writer.write_event(event)
        self._writer.flush()

    def close(self) -> None:
        """Close the current file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _clear(self) -> None:
        self.close()
        self._counts, self._cleared = {}, True
        for path in event_files(self._folder):
            path.write_bytes(b"")  # not deleted: a running TensorBoard would stop at a missing file


def _common(points: Sequence[Point], written: Mapping[str, deque[tuple[int, float]]]) -> int:
    """Count the leading `points` that are already in `written`, and remove them from it."""
    for index, (step, scalars) in enumerate(points):
        expected = {tag: (step, float(np.float32(value))) for tag, value in scalars.items()}
        if any(not written.get(tag) or written[tag][0] != value for tag, value in expected.items()):
            return index
        for tag in expected:
            written[tag].popleft()
    return len(points)


class EventFolder(Tracker):
    """TensorBoard log folder of a results root, with a sub-folder of event files per run.

    Files of an earlier tracker are continued, or replaced if they contradict the root.

    Args:
        root: folder, or ``s3://`` or ``gs://`` address.
        folder: TensorBoard's ``--logdir``, created if missing.

    Raises:
        ResultsRootError: if the results root is missing or of another version.
        ValueError: if tensorboardX is not installed, or `folder` cannot be created.
    """

    def __init__(self, root: str | Path, folder: str | Path) -> None:
        if find_spec("tensorboardX") is None:
            raise ValueError("event files need tensorboardX: pip install 'tma_ray[tensorboard]'")
        super().__init__(root)
        if "://" in str(folder):
            raise ValueError(f"{folder}: expected a folder of this machine; TensorBoard reads it from there")
        self._folder = expanded(folder).absolute()
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"{folder} cannot be made ({error.strerror}); choose another folder") from error
        self._existing = {path.name: path for path in self._folder.rglob("seed_*") if path.is_dir()}
        self._runs: dict[str, RunEvents] = {}

    def close(self) -> None:
        """Close all files."""
        for run in self._runs.values():
            run.close()

    def _write(self, manifest: Manifest, points: Mapping[Table, Sequence[Point]], experiment: str) -> bool:
        run_id = manifest.run.run_id
        if run_id not in self._runs:
            folder = self._folder / run_folder(manifest.run, experiment)
            self._runs[run_id] = RunEvents(self._existing.get(folder.name, folder))
        new = self._runs[run_id].append(points)
        if manifest.status is not RunStatus.RUNNING:
            self._runs[run_id].close()
        return new


def run_folder(run: RunRecord, experiment: str) -> Path:
    """Return the relative path of the sub-folder of a run's event files."""
    names = run.student, run.challenge, run.embodiment, run.expert_knowledge
    setting = "-".join(_plain(name) for name in names if name)
    return Path(_plain(experiment), _plain(run.teacher), setting, f"seed_{_plain(run.seed)}-{run.run_id}")


def _plain(name: object) -> str:
    """Return `name` as a safe folder name, even if it is ``..``."""
    return re.sub(r"[^0-9A-Za-z._=-]+", "_", str(name)).strip("._")[:100] or "unnamed"

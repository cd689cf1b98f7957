"""One event file of TensorBoard, through tensorboardX, which is imported when a file is opened."""

from __future__ import annotations

import re
import struct
import time
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np

from analysis.tracking.points import TABLES, Point, experiments_of, published_points
from tma_ray.commands.values import expanded
from tma_ray.decoding import read_file
from tma_ray.results import Manifest, Results, RunRecord, RunStatus, Table

_NAMES: Final = "events.out.tfevents.*"

_LENGTH: Final = struct.Struct("<Q")
"""Before every record: its bytes. A checksum of 4 bytes follows this and the record."""


def check_installed() -> None:
    """Refuse to go on without tensorboardX.

    Raises:
        ValueError: it is not installed.
    """
    if find_spec("tensorboardX") is None:
        raise ValueError("event files need tensorboardX: pip install 'tma_ray[tensorboard]'")


def event_files(folder: Path) -> list[Path]:
    """Return the event files in `folder`, but no links, in the order in which TensorBoard reads them."""
    return sorted(path for path in folder.glob(_NAMES) if not path.is_symlink())


def read_scalars(files: Sequence[Path]) -> dict[str, deque[tuple[int, float]]]:
    """Return steps and values of every tag in `files`, each up to its first record that is not whole."""
    from google.protobuf.message import DecodeError
    from tensorboardX.proto.event_pb2 import Event

    found: dict[str, deque[tuple[int, float]]] = defaultdict(deque)
    for file in files:
        try:
            for record in _records(read_file(file)):
                event = Event.FromString(record)
                for value in event.summary.value:
                    found[value.tag].append((event.step, value.simple_value))
        except DecodeError:
            continue
    return found


def _records(content: bytes) -> Iterator[bytes]:
    start = _LENGTH.size + 4
    while start <= len(content):
        end = start + _LENGTH.unpack_from(content, start - 4 - _LENGTH.size)[0]
        if end + 4 > len(content):
            return
        yield content[start:end]
        start = end + 4 + _LENGTH.size + 4


class EventFile:
    """Scalars in the order in which they are added. TensorBoard may read along.

    tensorboardX's own `SummaryWriter` would need a thread and a queue for every file.

    Args:
        folder: folder of the file.
        number: number of this file among those that were opened in the same second.
    """

    def __init__(self, folder: Path, number: int) -> None:
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto.event_pb2 import Event

        self._event = Event
        self._writer = EventsWriter(str(folder / "events"), f".{number}")

    def add(self, step: int, scalars: Mapping[str, float]) -> None:
        """Add scalars by their tags at a step; nothing if there are none."""
        if scalars:
            event = self._event(wall_time=time.time(), step=step)
            for tag, value in scalars.items():
                event.summary.value.add(tag=tag, simple_value=value)
            self._writer.write_event(event)

    def start_anew(self) -> None:
        """Make a TensorBoard that looks on forget what it has read of this folder."""
        start = self._event(wall_time=time.time(), step=0)
        start.session_log.status = start.session_log.START
        self._writer.write_event(start)

    def flush(self) -> None:
        """Put on the disk what was added."""
        self._writer.flush()

    def close(self) -> None:
        """Flush and closes."""
        self._writer.close()


RUNS_AT_ONCE: Final = 32
"""How many runs are read together: fewer wait longer for an object store, more need more memory."""


@dataclass
class _Run:
    """What has been written of a run.

    Attributes:
        folder: folder of its event files.
        counts: points written, by table.
        files: files of its manifest when they were read.
        writer: writer of the growing file, if one is open.
        opened: number of files so far.
        cleared: True if points were withdrawn since the last file was opened.
    """

    folder: Path
    counts: dict[Table, int] = field(default_factory=dict)
    files: object = None
    writer: EventFile | None = None
    opened: int = 0
    cleared: bool = False


class EventFolder:
    """Event files of the runs of a results root, a sub-folder for each.

    Points are read from what the runs have published, and each is written once: an interrupted run goes on
    from a checkpoint, and so has nothing published that it will publish again. What an earlier one wrote
    into the same folder is continued; it is replaced where it says something else than the root, as after a
    step back to an older checkpoint. Other files stay.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.
        folder: for TensorBoard's ``--logdir``; made if it is not there.

    Raises:
        ResultsRootError: no results root at that place, or one of another version.
        ValueError: tensorboardX is not installed, or `folder` cannot be one.
    """

    def __init__(self, root: str | Path, folder: str | Path) -> None:
        check_installed()
        Results.open(root)  # refuses other places before a folder is made
        self._root, self._folder = root, _made(folder)
        self._existing = {path.name: path for path in self._folder.rglob("seed_*") if path.is_dir()}
        self._runs: dict[str, _Run] = {}

    def update(self) -> int:
        """Write what has been published since the last time.

        Returns:
            Of how many runs there was something.
        """
        results = Results.open(self._root)
        seen = {run_id: run.files for run_id, run in self._runs.items()}
        news = [manifest for manifest in results.runs() if seen.get(manifest.run.run_id) != manifest.files]
        count = 0
        for start in range(0, len(news), RUNS_AT_ONCE):
            count += self._write(results, news[start : start + RUNS_AT_ONCE])
        return count

    def close(self) -> None:
        """Close all files."""
        for run in self._runs.values():
            _close(run)

    def _write(self, results: Results, manifests: Sequence[Manifest]) -> int:
        unknown = [manifest for manifest in manifests if manifest.run.run_id not in self._runs]
        self._find_folders(results, unknown)
        found = published_points(results, manifests)
        count = 0
        for manifest in manifests:
            run = self._runs[manifest.run.run_id]
            points = {table: found.get((manifest.run.run_id, table), []) for table in TABLES}
            count += self._append(run, points)
            run.files = manifest.files
            if manifest.status is not RunStatus.RUNNING:
                _close(run)
        return count

    def _append(self, run: _Run, points: Mapping[Table, Sequence[Point]]) -> bool:
        """Write the points that are new; all of them again if some were taken back."""
        if not run.counts:
            _count_written(run, points)
        elif any(len(points[table]) < count for table, count in run.counts.items()):
            _clear(run)
        new = [point for table in TABLES for point in points[table][run.counts.get(table, 0) :]]
        run.counts = {table: len(points[table]) for table in TABLES}
        if not new:
            return False
        if run.writer is None:
            run.folder.mkdir(parents=True, exist_ok=True)
            run.writer = EventFile(run.folder, run.opened)
            run.opened += 1
            if run.cleared:
                run.writer.start_anew()
                run.cleared = False
        for step, scalars in sorted(new, key=lambda point: point[0]):
            run.writer.add(step, scalars)
        run.writer.flush()
        return True

    def _find_folders(self, results: Results, manifests: Sequence[Manifest]) -> None:
        """Give each run the folder that it has, or a new one."""
        experiments = experiments_of(results, manifests)
        for manifest in manifests:
            run_id = manifest.run.run_id
            place = self._folder / run_folder(manifest.run, experiments.get(run_id, "single runs"))
            self._runs[run_id] = _Run(self._existing.get(place.name, place))


def run_folder(run: RunRecord, experiment: str) -> Path:
    """Return the folder of the event files of a run of this experiment."""
    names = run.student, run.challenge, run.embodiment, run.expert_knowledge
    setting = "-".join(_plain(name) for name in names if name)
    return Path(_plain(experiment), _plain(run.teacher), setting, f"seed_{_plain(run.seed)}-{run.run_id}")


def _plain(name: object) -> str:
    """Return `name` as that of a folder: anything may be read from a root, even a path upwards."""
    return re.sub(r"[^0-9A-Za-z._=-]+", "_", str(name)).strip("._")[:100] or "unnamed"


def _made(folder: str | Path) -> Path:
    if "://" in str(folder):
        raise ValueError(f"{folder}: expected a folder of this machine; TensorBoard reads it from there")
    path = expanded(folder).absolute()
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"{folder} cannot be made ({error.strerror}); choose another folder") from error
    return path


def _count_written(run: _Run, points: Mapping[Table, Sequence[Point]]) -> None:
    """Count what is in the folder of `run`; take it away if it is not the beginning of its `points`."""
    files = event_files(run.folder)
    run.opened = len(files)
    written = read_scalars(files)
    run.counts = {table: _common(points[table], written) for table in TABLES}
    if any(written.values()):
        _clear(run)


def _common(points: Sequence[Point], written: Mapping[str, deque[tuple[int, float]]]) -> int:
    """Return the number of `points` that come first in `written`, by tag, and remove them there."""
    for index, (step, scalars) in enumerate(points):
        expected = {tag: (step, float(np.float32(value))) for tag, value in scalars.items()}
        if any(not written.get(tag) or written[tag][0] != value for tag, value in expected.items()):
            return index
        for tag in expected:
            written[tag].popleft()
    return len(points)


def _clear(run: _Run) -> None:
    _close(run)
    run.counts, run.cleared = {}, True
    for path in event_files(run.folder):
        path.write_bytes(b"")  # a TensorBoard that has it open goes on to the next; a lost file stops it


def _close(run: _Run) -> None:
    if run.writer is not None:
        run.writer.close()
        run.writer = None

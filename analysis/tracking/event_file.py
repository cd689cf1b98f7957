"""One event file of TensorBoard, through tensorboardX, which is imported when a file is opened."""

from __future__ import annotations

import struct
import time
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final

_NAMES: Final = "events.out.tfevents.*"

_LENGTH: Final = struct.Struct("<Q")
"""Before every record: its bytes. A checksum of 4 bytes follows this and the record."""


def check_installed() -> None:
    """Refuses to go on without tensorboardX.

    Raises:
        ValueError: it is not installed.
    """
    if find_spec("tensorboardX") is None:
        raise ValueError("event files need tensorboardX: pip install 'tma_ray[tensorboard]'")


def event_files(folder: Path) -> list[Path]:
    """Returns the event files in `folder`, but no links, in the order in which TensorBoard reads them."""
    return sorted(path for path in folder.glob(_NAMES) if not path.is_symlink())


def read_scalars(files: Sequence[Path]) -> dict[str, deque[tuple[int, float]]]:
    """Returns steps and values of every tag in `files`, each up to its first record that is not whole."""
    from google.protobuf.message import DecodeError
    from tensorboardX.proto.event_pb2 import Event

    found: dict[str, deque[tuple[int, float]]] = defaultdict(deque)
    for file in files:
        try:
            for record in _records(file.read_bytes()):
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
        folder: where it lies.
        number: tells it from other files of this folder that were opened in the same second.
    """

    def __init__(self, folder: Path, number: int) -> None:
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto.event_pb2 import Event

        self._event = Event
        self._writer = EventsWriter(str(folder / "events"), f".{number}")

    def add(self, step: int, scalars: Mapping[str, float]) -> None:
        """Adds scalars by their tags at a step; nothing if there are none."""
        if scalars:
            event = self._event(wall_time=time.time(), step=step)
            for tag, value in scalars.items():
                event.summary.value.add(tag=tag, simple_value=value)
            self._writer.write_event(event)

    def start_anew(self) -> None:
        """Makes a TensorBoard that looks on forget what it has read of this folder."""
        start = self._event(wall_time=time.time(), step=0)
        start.session_log.status = start.session_log.START
        self._writer.write_event(start)

    def flush(self) -> None:
        """Puts on the disk what was added."""
        self._writer.flush()

    def close(self) -> None:
        """Flushes and closes."""
        self._writer.close()

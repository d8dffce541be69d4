"""Events: numbers and pictures by tag and step, in the record files that TensorBoard reads, and a reader that goes along.

A file is a row of records: length (u64), masked CRC-32C of the length, content, masked CRC-32C of the content; a content
is one `Event` with its wall time, step, and tagged values. A resumed run adds a file; where a step was done twice the
later value counts. The reader takes what was appended since it last looked, waits at a record that is half there, passes
over one whose content is broken, and never raises for what is in a file.
"""

from __future__ import annotations

import os
import socket
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.compat.tensorflow_stub.pywrap_tensorflow import masked_crc32c
from tensorboard.summary.writer.record_writer import RecordWriter

from avatarrex.errors import plain
from avatarrex.training.runs.control import cannot_write

PREFIX = "events.out.tfevents."
SCALARS_BYTES = 1 << 16
"""A longer record holds a picture: the reader, who wants numbers, passes over it unread."""
TAGS, TAG = 1000, 200
"""Names of numbers that are read, and letters of each: a training has a few dozen; what is beyond them is passed over."""
READ_BYTES = 4 << 20
"""Of one file in one look, so that a long history comes in pieces."""


class EventWriter:
    """One new event file. What was written stands in the file at once: a killed process loses nothing."""

    def __init__(self, folder: Path) -> None:
        before = event_files(folder)
        stamp = max([int(time.time()), *(_stamp(path) for path in before)])  # names sort as they were made
        name = f"{PREFIX}{stamp:010d}.{len(before):06d}.{socket.gethostname()}.{os.getpid()}"
        self._file = _Appended(folder / name)
        self._records = RecordWriter(self._file)
        self._records.write(Event(wall_time=time.time(), file_version="brain.Event:2").SerializeToString())

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Numbers at one step (kept in single precision). Raises `InputError` where the disk is full."""
        self._add(step, [Summary.Value(tag=tag, simple_value=value) for tag, value in values.items()])

    def picture(self, step: int, tag: str, png: bytes, size: tuple[int, int]) -> None:
        """A PNG of `size` (width, height), RGB."""
        width, height = size
        image = Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=png)
        self._add(step, [Summary.Value(tag=tag, image=image)])

    def sync(self) -> None:
        """Flush to the disk itself."""
        self._file.sync()

    def close(self) -> None:
        """Close the file."""
        self._records.close()

    def _add(self, step: int, values: list[Summary.Value]) -> None:
        self._records.write(Event(wall_time=time.time(), step=step, summary=Summary(value=values)).SerializeToString())


class _Appended:
    """A file that takes a whole record or none: what a full disk cut short is taken back."""

    def __init__(self, path: Path) -> None:
        self._path, self.closed = path, False
        try:
            self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        except OSError as error:
            raise cannot_write(path, error) from None
        self._size = 0

    def write(self, record: bytes) -> None:
        """Append one record. Raises `InputError`."""
        done = 0
        try:
            while done < len(record):
                done += os.write(self._handle, record[done:])
        except OSError as error:
            os.ftruncate(self._handle, self._size)
            os.lseek(self._handle, self._size, os.SEEK_SET)
            raise cannot_write(self._path, error) from None
        self._size += done

    def flush(self) -> None:
        """Nothing waits in memory."""

    def sync(self) -> None:
        os.fsync(self._handle)

    def close(self) -> None:
        if not self.closed:
            os.close(self._handle)
        self.closed = True


@dataclass(frozen=True)
class Series:
    """One tag's values by rising step, each step once."""

    steps: Int64[np.ndarray, "p"]
    values: Float64[np.ndarray, "p"]
    times: Float64[np.ndarray, "p"]
    """Wall time of each value, seconds since 1970."""


class EventReader:
    """The numbers in a folder's event files, as far as they have been read."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.notes: dict[str, str] = {}
        """By file name: why it is not read on."""
        self.count = 0
        """Values read so far: unchanged where there was nothing new."""
        self._offsets: dict[Path, int] = {}
        self._values: dict[str, list[tuple[int, float, float]]] = {}
        self._series: dict[str, tuple[int, Series]] = {}

    def poll(self, limit: int = READ_BYTES) -> bool:
        """Read on, at most `limit` bytes of each file; True where more is waiting."""
        waiting = False
        for path in event_files(self.folder):
            try:
                waiting |= self._read(path, limit)
            except OSError as error:
                self.notes[path.name] = error.strerror or str(error)
            if waiting:
                break  # files in their order: the later value counts
        return waiting

    @property
    def tags(self) -> tuple[str, ...]:
        """Every tag, sorted."""
        return tuple(sorted(self._values))

    def series(self, tag: str) -> Series:
        """The values of `tag`, empty where there is none."""
        entries = self._values.get(tag, [])
        count, series = self._series.get(tag, (-1, None))
        if series is None or count != len(entries):
            series = _ordered(entries)
            self._series[tag] = len(entries), series
        return series

    def _read(self, path: Path, limit: int) -> bool:
        offset, size = self._offsets.get(path, 0), path.stat().st_size
        if size <= offset:
            return False
        with open(path, "rb") as file:
            file.seek(offset)
            block = file.read(limit)
            used, reason = self._take(block, size - offset)
        self._offsets[path] = offset + used
        if reason:
            self.notes[path.name] = f"{reason} at byte {offset + used}"
        else:
            self.notes.pop(path.name, None)
        return used > 0 and offset + used < size and not reason

    def _take(self, block: bytes, ahead: int) -> tuple[int, str]:
        """Take the records of `block`, of which `ahead` bytes follow in the file; the bytes used, and why it stopped."""
        place = 0
        while place + 12 <= len(block):
            length, crc = struct.unpack_from("<QI", block, place)
            if masked_crc32c(block[place : place + 8]) != crc:
                return place, "a broken record"
            end = place + 16 + length
            if end > ahead:
                return place, ""  # half there: it comes, or its writer was killed
            if length > SCALARS_BYTES:
                place = end
                continue
            if end > len(block):
                return place, ""
            content = block[place + 12 : end - 4]
            if masked_crc32c(content) == struct.unpack_from("<I", block, end - 4)[0]:
                self._note(content)
            elif end == ahead:
                return place, "a broken record"
            place = end
        return min(place, ahead), ""

    def _note(self, content: bytes) -> None:
        try:
            event = Event.FromString(content)
        except Exception:  # the protobuf library's own error: intact bytes that are no event
            return
        for value in event.summary.value:
            if value.HasField("simple_value"):
                tag = plain(value.tag)[:TAG]
                if tag not in self._values and len(self._values) == TAGS:
                    continue
                self._values.setdefault(tag, []).append((event.step, value.simple_value, event.wall_time))
                self.count += 1


def event_files(folder: Path) -> list[Path]:
    """The event files of a run in the order in which they were made."""
    return sorted(path for path in folder.glob(PREFIX + "*") if path.is_file())


def _ordered(entries: list[tuple[int, float, float]]) -> Series:
    table = np.array(entries, np.float64).reshape(-1, 3)
    steps = table[:, 0].astype(np.int64)
    if len(steps) > 1 and not (np.diff(steps) > 0).all():
        _, last = np.unique(steps[::-1], return_index=True)
        keep = len(steps) - 1 - last
        steps, table = steps[keep], table[keep]
    return Series(steps, table[:, 1].copy(), table[:, 2].copy())


def _stamp(path: Path) -> int:
    digits = path.name.removeprefix(PREFIX).partition(".")[0]
    return int(digits) if digits.isdigit() else 0

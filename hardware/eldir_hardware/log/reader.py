"""Reads the log of a run back."""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter, deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.exceptions import InvalidMagic
from mcap.reader import McapReader, NonSeekingReader, SeekingReader
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema, Statistics
from mcap.summary import Summary
from numpy.typing import NDArray

from eldir.core.records import BoolArray, FloatArray
from eldir.errors import EldirError, InputError, damaged, empty, not_read
from eldir.trajectory import Trajectory
from eldir_hardware.images import jpeg
from eldir_hardware.log import messages as m
from eldir_hardware.log.bag import log_in

_AHEAD = 8  # pictures decoded before they are asked for
_MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True)
class RunLog:
    """The contents of a log; times are seconds from the run's start."""

    path: Path
    tracks: Trajectory | None
    """Marks as tracked during the run; None if they were not tracked."""
    channels: tuple[str, ...]
    """Names of the relay contacts, length C."""
    relay_times: FloatArray
    """Times of the relay states [s], shape (N,)."""
    relays: BoolArray
    """Whether each contact was closed, shape (N, C)."""
    springs: tuple[str, ...]
    """Names of the springs whose temperatures were recorded, length A."""
    temperature_times: FloatArray
    """Times of the temperatures [s], shape (K,)."""
    temperatures: FloatArray
    """Modelled temperature of each spring [C], shape (K, A)."""
    statuses: tuple[tuple[float, str, str], ...]
    """Time [s], part of the rig, message."""
    attachments: dict[str, bytes]
    """Files kept with the log, by name."""
    frame_count: int
    epoch_ns: int
    """Time of day at the start [ns since 1970]."""
    recovered: str | None
    """What `eldir recover` reported as missing; None for a log that was never damaged."""
    current_times: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Times of the measured currents and voltages [s], shape (L,)."""
    currents: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """Measured current of each of `springs` [A], shape (L, A); NaN where it is not measured, no columns
    without a current sensor."""
    voltages: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """Measured voltage across each spring [V], shape (L, A)."""

    @property
    def frames(self) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Time [s] and BGR picture of every frame, decoded a few ahead by another thread."""
        ahead: deque[tuple[float, Future[NDArray[np.uint8]]]] = deque()
        with ThreadPoolExecutor(1) as decoder:
            for stamp, data in self.pictures:
                ahead.append((self._seconds(stamp), decoder.submit(jpeg.decode, data)))
                if len(ahead) > _AHEAD:
                    t, image = ahead.popleft()
                    yield t, image.result()
            for t, image in ahead:
                yield t, image.result()

    def frame_from(self, t: float) -> NDArray[np.uint8] | None:
        """The first picture that is not older than `t` [s]."""
        data = next((data for stamp, data in self.pictures if self._seconds(stamp) >= t), None)
        return None if data is None else jpeg.decode(data)

    def _seconds(self, stamp: int) -> float:
        return (stamp - self.epoch_ns) * 1e-9

    @property
    def pictures(self) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """Time of day [ns] and JPEG bytes of every frame, as recorded."""
        for _, stamp, message in messages(self.path, [m.IMAGE]):
            yield stamp, message.data


def read_log(path: Path | str) -> RunLog:
    """Read all of a log except its frames; `RunLog.frames` reads those later.

    `path` is a file, or the folder of a bag. Raises `InputError` for one that is missing, empty,
    damaged, cut off, or no log of a robot.
    """
    path = log_in(Path(path))
    found = contents(path)
    epoch, topics = found.epoch_ns, found.topics
    rows: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in topics}
    for topic, stamp, message in messages(path, [t for t in topics if t != m.IMAGE]):
        rows[topic].append((stamp, message))

    def seconds(stamps: list[int]) -> FloatArray:
        return (np.array(stamps, np.int64) - epoch) * 1e-9

    springs = tuple(t.split("/")[2] for t in topics if t.startswith("/springs/"))
    heat = [rows[m.spring_topic(s)] for s in springs]
    heat_times = [stamp for stamp, _ in heat[0]] if heat else []
    degrees = [[reading.temperature for _, reading in h] for h in heat]
    relays = rows.get(m.RELAYS, [])
    channels = tuple(relays[0][1].name) if relays else ()
    return RunLog(
        path=path,
        tracks=_tracks(path, [message for _, message in rows.get(m.MARKERS, [])], epoch),
        channels=channels,
        relay_times=seconds([stamp for stamp, _ in relays]),
        relays=np.array([r.position for _, r in relays], float).reshape(len(relays), len(channels)) > 0.5,
        springs=springs,
        temperature_times=seconds(heat_times),
        temperatures=np.array(degrees, float).reshape(len(heat), len(heat_times)).T,
        statuses=tuple(
            ((stamp - epoch) * 1e-9, status.name, status.message)
            for stamp, message in rows.get(m.STATUS, [])
            for status in message.status
        ),
        attachments=found.attachments,
        frame_count=topics.get(m.IMAGE, 0),
        epoch_ns=epoch,
        recovered=found.note.get("recovered"),
        current_times=seconds([stamp for stamp, _ in rows.get(m.CURRENTS, [])]),
        currents=_values(rows.get(m.CURRENTS, []), springs),
        voltages=_values(rows.get(m.VOLTAGES, []), springs),
    )


def _values(rows: list[tuple[int, Any]], names: tuple[str, ...]) -> FloatArray:
    """One row for each message, in the order of `names`; NaN for a name that it does not have."""
    if not rows:
        return np.zeros((0, 0))
    table = [dict(zip(message.name, message.position, strict=True)) for _, message in rows]
    return np.array([[row.get(name, np.nan) for name in names] for row in table], float)


@dataclass(frozen=True)
class LogContents:
    """What a log says of itself, without its messages."""

    note: dict[str, str]
    """Our metadata record."""
    attachments: dict[str, bytes]
    topics: dict[str, int]
    """Number of messages of each topic."""
    end_ns: int
    """Time of day of the last message [ns since 1970]."""

    @property
    def epoch_ns(self) -> int:
        """Time of day at the start [ns since 1970]."""
        return int(self.note["epoch_ns"])


def contents(path: Path) -> LogContents:
    """What a log says of itself; all of its bytes are checked. Raises `InputError` as `read_log` does."""
    with _reader(path, whole=True) as reader:
        records = reader.iter_metadata()
        ours = [r.metadata for r in records if r.name == m.METADATA]
        if not ours:
            raise InputError(
                f"{path} is not the log of a run",
                code="log.other-file",
                expected="one written by `eldir rig drive` or `eldir demo`",
                found=f"an MCAP file by {reader.get_header().library or 'another program'}",
            )
        attachments = {a.name: a.data for a in reader.iter_attachments()}
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None  # `_LinearReader` counts for itself
        counts = summary.statistics.channel_message_counts
        topics: dict[str, int] = {}
        for number, channel in sorted(summary.channels.items()):
            topics[channel.topic] = topics.get(channel.topic, 0) + counts.get(number, 0)
        return LogContents(ours[0], attachments, topics, summary.statistics.message_end_time)


def messages(path: Path, topics: list[str]) -> Iterator[tuple[str, int, Any]]:
    """Topic, stamp [ns] and message, in the order of time."""
    if not topics:
        return
    with _reader(path) as reader:
        for schema, channel, record in reader.iter_messages(topics):
            if schema is not None:
                yield channel.topic, record.log_time, m.types().deserialize_cdr(record.data, schema.name)


def _check_sums(file: BinaryIO) -> None:
    """Compare the sums at the end of the data and of the summary; readers leave these two out.

    The file ends with: a record (13 bytes) that holds the sum of the data, the summary, and a
    footer of which the last 28 bytes are where the summary starts (8), an offset (8), the sum of
    the summary (4) and the mark (8).
    """
    end = file.seek(0, os.SEEK_END) - 28
    if end < 0:
        raise InvalidMagic(b"")
    file.seek(end)
    summary, _, summary_sum, mark = struct.unpack("<QQI8s", file.read(28))
    if mark != _MAGIC:
        raise InvalidMagic(mark)
    summary = summary or end - 9  # 0 where there is none: then the footer follows the data
    if not 13 < summary <= end:
        raise ValueError("the summary is not where the footer says")
    file.seek(summary - 4)
    (data_sum,) = struct.unpack("<I", file.read(4))
    for start, stop, wanted in ((0, summary - 13, data_sum), (summary, end + 16, summary_sum)):
        file.seek(start)
        found, left = 0, stop - start
        while left and (block := file.read(min(left, 1 << 20))):
            found, left = zlib.crc32(block, found), left - len(block)
        if wanted and found != wanted:  # 0: whoever wrote it took no sum
            raise ValueError("a check sum is wrong")


def _is_complete(summary: Summary | None) -> bool:
    """Whether a summary lists everything: its parts are optional, and other programs leave some out."""
    if summary is None or summary.statistics is None:
        return False
    counted = summary.statistics
    return len(summary.chunk_indexes) > 0 and (
        len(summary.schemas),
        len(summary.channels),
        len(summary.chunk_indexes),
        len(summary.attachment_indexes),
        len(summary.metadata_indexes),
    ) == (
        counted.schema_count,
        counted.channel_count,
        counted.chunk_count,
        counted.attachment_count,
        counted.metadata_count,
    )


class _LinearReader(McapReader):
    """Reads all of a log in the order of the file, where its summary is not complete."""

    def __init__(self, file: BinaryIO):
        super().__init__()
        self._file = file

    def _from_start(self) -> NonSeekingReader:
        self._file.seek(0)
        return NonSeekingReader(self._file, validate_crcs=True)

    def get_header(self) -> Header:
        return self._from_start().get_header()

    def iter_attachments(self) -> Iterator[Attachment]:
        return self._from_start().iter_attachments()

    def iter_metadata(self) -> Iterator[Metadata]:
        return self._from_start().iter_metadata()

    def iter_messages(self, *args: Any, **options: Any) -> Iterator[tuple[Schema | None, Channel, Message]]:
        return self._from_start().iter_messages(*args, **options)

    def get_summary(self) -> Summary:
        """Channels and statistics of the messages, counted."""
        summary, counts, end = Summary(), Counter[int](), 0
        for _, channel, message in self._from_start().iter_messages(log_time_order=False):
            summary.channels[channel.id] = channel
            counts[channel.id] += 1
            end = max(end, message.log_time)
        summary.statistics = Statistics(
            message_count=counts.total(),
            channel_message_counts=counts,
            message_start_time=0,
            message_end_time=end,
            channel_count=len(summary.channels),
            schema_count=0,
            attachment_count=0,
            metadata_count=0,
            chunk_count=0,
        )
        return summary


@contextmanager
def _reader(path: Path, whole: bool = False) -> Iterator[McapReader]:
    """Open a log; `whole`: check all of its bytes. Raises `InputError` that names the problem."""
    try:
        with path.open("rb") as file:
            if not file.read(8):
                raise empty(path, "an MCAP log")
            if whole:
                _check_sums(file)
            file.seek(0)
            indexed = SeekingReader(file, validate_crcs=True)
            yield indexed if _is_complete(indexed.get_summary()) else _LinearReader(file)
    except InvalidMagic:
        raise InputError(
            f"{path} is not a whole MCAP log",
            code="log.not-whole",
            expected="MCAP's mark at its beginning and end",
            found="another kind of file, or a log that was cut off",
            remedy="if the log was cut off: eldir recover",
        ) from None
    except OSError as error:
        raise not_read(path, error) from None
    except EldirError:
        raise
    except Exception as error:  # parsers and decompressors fail in many ways on damaged bytes
        found, remedy = f"{type(error).__name__}: {error}", "recover the valid records: eldir recover"
        raise damaged(path, "a whole MCAP log", found, remedy) from None


def _tracks(path: Path, arrays: list[Any], epoch: int) -> Trajectory | None:
    """The trajectory in a run's marker arrays; a deleted marker is a mark that was not seen."""
    if not arrays:
        return None
    names = tuple(marker.ns for marker in arrays[0].markers)
    stamps = [a.markers[0].header.stamp for a in arrays]
    times = np.array([s.sec * 1_000_000_000 + s.nanosec - epoch for s in stamps], np.int64) * 1e-9
    if (np.diff(times) < 0).any():
        raise damaged(path, "marks in the order of time")
    places = [
        [(k.pose.position.x, k.pose.position.z) if k.action == k.ADD else (np.nan, np.nan) for k in a.markers]
        for a in arrays
    ]
    return Trajectory(names, times, np.array(places))

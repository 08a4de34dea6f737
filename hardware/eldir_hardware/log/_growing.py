"""A log that grows: an MCAP file that can be recovered up to its last second if the program dies."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.reader import SeekingReader
from mcap.records import Channel, Schema
from mcap.summary import Summary
from mcap.writer import CompressionType, Writer

from eldir.core.files import require_new, write_text
from eldir.core.records import FileRecord
from eldir.core.yaml_files import dump_yaml
from eldir.errors import EldirError, not_written
from eldir_hardware.log import messages as m
from eldir_hardware.log._salvage import with_crc
from eldir_hardware.log.mcap_file import BAG_METADATA
from eldir_hardware.resource import Resource

_FLUSH_INTERVAL = 0.5
"""Interval at which records are handed to the file, in the log's time [s]."""
_METADATA_INTERVAL = 10.0
"""Interval at which the metadata for `recover` are repeated, in the log's time [s]."""
_BAG_VERSION = 8
"""Version of the metadata that Jazzy reads; version 7 added hashes of the types, 9 changed the QoS."""
_KINDS = {".json": "application/json", ".yaml": "application/yaml"}


class GrowingLog(Resource):
    """A log file, between `open` and `close` or in a `with`. Times are seconds from the start of the run. Any
    thread may write."""

    def __init__(self, path: Path | str, epoch_ns: int | None = 0, facts: Mapping[str, str] | None = None):
        """`epoch_ns`: time of day at t = 0; 0 for a virtual run, so that its bytes repeat; None where
        `begin_at` will set it. `facts`: texts for the log's metadata, such as digests of the run's files."""
        self.path = Path(path)
        self._epoch = m.VIRTUAL_EPOCH if epoch_ns == 0 else epoch_ns
        self._facts = dict(facts or {})
        self._file: BinaryIO | None = None
        self._writer: Writer | None = None
        self._lock = threading.RLock()
        self._channel_ids: dict[str, int] = {}  # topic to channel
        self._channel_types: dict[str, str] = {}  # topic to type
        self._schemas: dict[str, int] = {}
        self._sequence: dict[str, int] = {}
        self._flushed_at = self._metadata_at = -np.inf
        self._recorded_channels = -1
        self._last_ns = time.time_ns() if self._epoch is None else self._epoch

    def open(self) -> None:
        """Create the file. Raises `EldirError` where it exists or cannot be written."""
        require_new(self.path)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("xb")
        except OSError as error:
            raise self._cannot_write(error) from None
        self._writer = Writer(self._file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._writer.start(profile="ros2", library=f"eldir {version('eldir')}")
        self._flush()

    def close(self) -> None:
        """Finish the file and describe its bag. Raises `EldirError` where the disk is full."""
        writer, file = self._opened()
        if self._epoch is None:  # the run did not begin
            self.begin_at(self._last_ns)
        self._writer = self._file = None
        try:
            writer.finish()
            file.flush()
            os.fsync(file.fileno())
            describe_bag(self.path)
        except OSError as failed:
            raise self._cannot_write(failed) from None
        finally:
            with suppress(OSError):
                file.close()

    def begin_at(self, epoch_ns: int) -> None:
        """Set the time of day at t = 0. Messages written before have the time of day as their time."""
        self._epoch = epoch_ns
        self._flush()

    def attach(self, name: str, file: FileRecord | bytes) -> None:
        """Attach a file to the log, such as design.json; the ending of its name gives its type."""
        kind = _KINDS.get(Path(name).suffix, "text/plain")
        data = file if isinstance(file, bytes) else file.to_text().encode()
        with self._lock:
            writer, _ = self._opened()
            writer.add_attachment(self._last_ns, self._last_ns, name, kind, data)
            self._flush()

    def flush(self) -> None:
        """Hand all records to the file, where other programs can read them."""
        self._flush()

    def sync(self) -> None:
        """Force all records onto the disk, so that they survive a power cut."""
        _, file = self._opened()
        self._flush()
        try:
            os.fdatasync(file.fileno())
        except OSError as error:
            raise self._cannot_write(error) from None

    def _write(self, topic: str, kind: str, t: float, message: Any) -> None:
        with self._lock:
            writer, _ = self._opened()
            if topic not in self._channel_ids:
                self._channel_ids[topic] = self._register(writer, topic, m.MESSAGE_TYPES[kind])
                self._channel_types[topic] = m.MESSAGE_TYPES[kind].name
            now = self._to_ns(t)
            self._last_ns = now
            sequence = self._sequence[topic] = self._sequence.get(topic, 0) + 1
            data = bytes(m.typestore().serialize_cdr(message, m.MESSAGE_TYPES[kind].name))
            try:
                writer.add_message(self._channel_ids[topic], now, data, now, sequence)
            except OSError as error:  # a full chunk is written at once
                raise self._cannot_write(error) from None
            if t - self._flushed_at >= _FLUSH_INTERVAL:
                self._flushed_at = t
                self._flush()

    def _register(self, writer: Writer, topic: str, kind: m.MessageType) -> int:
        if kind.name not in self._schemas:
            definition = kind.definition.encode()
            self._schemas[kind.name] = writer.register_schema(kind.name, "ros2msg", definition)
        metadata = {"offered_qos_profiles": kind.qos}
        return writer.register_channel(topic, "cdr", self._schemas[kind.name], metadata)

    def _flush(self) -> None:
        with self._lock:
            writer, file = self._opened()
            due = self._flushed_at - self._metadata_at >= _METADATA_INTERVAL
            try:
                if self._epoch is not None and (due or len(self._channel_ids) != self._recorded_channels):
                    writer.add_metadata(m.METADATA, self._make_metadata())
                    self._recorded_channels, self._metadata_at = len(self._channel_ids), self._flushed_at
                writer.flush()
                file.flush()
            except OSError as error:
                raise self._cannot_write(error) from None

    def _make_metadata(self) -> dict[str, str]:
        """Start time and channels: messages stay readable if the chunk with their channels is lost."""
        channels = {
            number: (topic, self._channel_types[topic]) for topic, number in self._channel_ids.items()
        }
        return with_crc({"epoch_ns": str(self._epoch), "channels": json.dumps(channels)} | self._facts)

    def _cannot_write(self, error: OSError) -> EldirError:
        return not_written(self.path, error, "choose another place, or free disk space")

    def _opened(self) -> tuple[Writer, BinaryIO]:
        if self._writer is None or self._file is None:
            raise EldirError(
                f"the log {self.path} is not open",
                code="log.not-open",
                remedy="record inside `with Recorder(...)`",
            )
        return self._writer, self._file

    def _to_ns(self, t: float) -> int:
        if self._epoch is None:  # an event before the start, such as a refusal to arm
            return time.time_ns()
        return self._epoch + round(t * 1e9)


def describe_bag(log: Path) -> Path | None:
    """Write `metadata.yaml` beside a finished log, for `ros2 bag play FOLDER`. Return None if the folder
    already describes another log, because a bag is one recording; `ros2 bag` can open the file itself."""
    path = log.parent / BAG_METADATA
    if path.exists():
        return None
    with log.open("rb") as file:
        summary = SeekingReader(file).get_summary()
    assert summary is not None  # we have just finished it
    text = dump_yaml({"rosbag2_bagfile_information": _information(log.name, summary)})
    write_text(path, text)
    return path


def _information(name: str, summary: Summary) -> dict[str, Any]:
    statistics = summary.statistics
    assert statistics is not None
    count = statistics.message_count
    times = {
        "starting_time": {"nanoseconds_since_epoch": statistics.message_start_time if count else 0},
        "duration": {"nanoseconds": statistics.message_end_time - statistics.message_start_time},
        "message_count": count,
    }
    topics = [
        {
            "topic_metadata": _topic(channel, summary.schemas[channel.schema_id]),
            "message_count": statistics.channel_message_counts.get(number, 0),
        }
        for number, channel in sorted(summary.channels.items())
    ]
    return {
        "version": _BAG_VERSION,
        "storage_identifier": "mcap",
        **times,
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [name],
        "files": [{"path": name, **times}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def _topic(channel: Channel, schema: Schema) -> dict[str, str]:
    return {
        "name": channel.topic,
        "type": schema.name,
        "serialization_format": channel.message_encoding,
        "offered_qos_profiles": channel.metadata.get("offered_qos_profiles", ""),
        "type_description_hash": m.MessageType(schema.name).digest
        if schema.name in m.typestore().types
        else "",
    }

"""A log that grows: an MCAP file that stays valid up to its last second if the program dies."""

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
from mcap.writer import CompressionType, Writer

from eldir.core.files import require_new
from eldir.core.records import FileRecord
from eldir.errors import EldirError, not_written
from eldir_hardware.log import bag
from eldir_hardware.log import messages as m
from eldir_hardware.log.salvage import with_crc
from eldir_hardware.resource import Resource

_FLUSH = 0.5
"""Interval at which records leave the program, in the log's time [s]."""
_REMIND = 10.0
"""Interval at which the data that `recover` needs are written again, in the log's time [s]."""
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
        self._known: dict[str, int] = {}  # topic to channel
        self._kinds: dict[str, str] = {}  # topic to type
        self._schemas: dict[str, int] = {}
        self._sequence: dict[str, int] = {}
        self._flushed = self._reminded = -np.inf
        self._noted = -1
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
        if self._epoch is None:  # it never began
            self.begin_at(self._last_ns)
        self._writer = self._file = None
        try:
            writer.finish()
            file.flush()
            os.fsync(file.fileno())
            bag.describe(self.path)
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
        """Attach a file to the log, such as design.json; the end of its name says what it is."""
        kind = _KINDS.get(Path(name).suffix, "text/plain")
        data = file if isinstance(file, bytes) else file.to_text().encode()
        with self._lock:
            writer, _ = self._opened()
            writer.add_attachment(self._last_ns, self._last_ns, name, kind, data)
            self._flush()

    def show(self) -> None:
        """Hand all records to the file, where other programs see them."""
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
            if topic not in self._known:
                self._known[topic] = self._register(writer, topic, m.KINDS[kind])
                self._kinds[topic] = m.KINDS[kind].name
            now = self._ns(t)
            self._last_ns = now
            sequence = self._sequence[topic] = self._sequence.get(topic, 0) + 1
            data = bytes(m.types().serialize_cdr(message, m.KINDS[kind].name))
            try:
                writer.add_message(self._known[topic], now, data, now, sequence)
            except OSError as error:  # a full chunk is written at once
                raise self._cannot_write(error) from None
            if t - self._flushed >= _FLUSH:
                self._flushed = t
                self._flush()

    def _register(self, writer: Writer, topic: str, kind: m.Kind) -> int:
        if kind.name not in self._schemas:
            definition = kind.definition.encode()
            self._schemas[kind.name] = writer.register_schema(kind.name, "ros2msg", definition)
        metadata = {"offered_qos_profiles": kind.qos}
        return writer.register_channel(topic, "cdr", self._schemas[kind.name], metadata)

    def _flush(self) -> None:
        with self._lock:
            writer, file = self._opened()
            due = self._flushed - self._reminded >= _REMIND
            try:
                if self._epoch is not None and (due or len(self._known) != self._noted):
                    writer.add_metadata(m.METADATA, self._note())
                    self._noted, self._reminded = len(self._known), self._flushed
                writer.flush()
                file.flush()
            except OSError as error:
                raise self._cannot_write(error) from None

    def _note(self) -> dict[str, str]:
        """Start time and channels, which keep messages readable if the chunk with their channels is lost."""
        channels = {number: (topic, self._kinds[topic]) for topic, number in self._known.items()}
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

    def _ns(self, t: float) -> int:
        if self._epoch is None:  # an event before the beginning, such as a board that does not arm
            return time.time_ns()
        return self._epoch + round(t * 1e9)

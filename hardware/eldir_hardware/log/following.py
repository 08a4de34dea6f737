"""Follows a log while another program writes it: each record as soon as it is in the file.

The writer is not asked and not delayed. A log that is finished is followed to its end in the same way.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Message, Metadata, Schema

from eldir.errors import InputError, damaged, not_read
from eldir_hardware.log import messages as m
from eldir_hardware.log.bag import log_in
from eldir_hardware.log.salvage import run_metadata, whole_record
from eldir_hardware.resource import Resource

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # kind of a record, length
_LARGEST = 1 << 28  # a longer record is damaged [bytes]


class Place(NamedTuple):
    """Where a message is in the file."""

    chunk: int
    """Offset of its chunk [bytes]."""
    number: int
    """Its number among the messages of that chunk."""


class LogMessage(NamedTuple):
    """One message."""

    topic: str
    stamp_ns: int
    message: Any
    place: Place


class LogFollower(Resource):
    """A log, between `open` and `close` or in a `with`."""

    def __init__(self, path: Path | str, topics: Collection[str] | None = None, raw: bool = False):
        """`topics`: those that `poll` gives; None for all. `raw`: it gives messages as the bytes (CDR) of the
        log."""
        self.path = log_in(Path(path))
        self.attachments: dict[str, bytes] = {}
        """Files kept with the log, as far as it was read."""
        self.epoch_ns: int | None = None
        """Time of day at the start [ns since 1970]; None before the run begins."""
        self.ended = False
        """Whether the program that wrote the log has finished it."""
        self.damaged = 0
        """Number of chunks and attachments whose checksum is wrong."""
        self._topics, self._raw = topics, raw
        self._at = 0
        self._channels: dict[int, tuple[str, str]] = {}  # topic and type
        self._schemas: dict[int, str] = {}

    def open(self) -> None:
        """Raises `InputError` for a file that is missing or no MCAP log."""
        try:
            self._file: BinaryIO = self.path.open("rb")
        except OSError as error:
            raise not_read(self.path, error) from None
        mark = self._file.read(len(_MAGIC))
        if mark and not _MAGIC.startswith(mark):
            self._file.close()
            problem, expected = f"{self.path} is no MCAP log", "a log of `eldir rig drive`"
            raise InputError(problem, code="log.other-file", expected=expected, found="another file")

    def close(self) -> None:
        self._file.close()

    @property
    def is_whole(self) -> bool:
        """Whether the file has its end: nobody writes it any more."""
        end = self._file.seek(0, 2)
        self._file.seek(max(end - len(_MAGIC), 0))
        return end > 2 * len(_MAGIC) and self._file.read() == _MAGIC

    def kind_of(self, topic: str) -> str:
        """Type of a topic that `poll` gave, such as sensor_msgs/msg/Temperature."""
        return next(kind for name, kind in self._channels.values() if name == topic)

    def poll(self) -> Iterator[LogMessage]:
        """Every message that has come since the last call, in the order of the file. Take them all: the next
        call goes on behind the chunk of the last one."""
        self._at = max(self._at, len(_MAGIC))
        while not self.ended and (content := self._next()) is not None:
            at, kind, body = content
            record = whole_record(kind, body)
            if isinstance(record, list):
                yield from self._messages(at, record)
            elif isinstance(record, Attachment):
                self.attachments[record.name] = record.data
            elif isinstance(record, Metadata):
                self.epoch_ns, _ = run_metadata(record)
            elif record is not None:
                self.damaged += 1
            self.ended = kind == Opcode.DATA_END

    def read(self, place: Place) -> Any:
        """The message at a place that `poll` gave."""
        self._file.seek(place.chunk)
        kind, length = _HEAD.unpack(self._file.read(_HEAD.size))
        found = whole_record(kind, memoryview(self._file.read(length)))
        messages = [r for r in found if isinstance(r, Message)] if isinstance(found, list) else []
        if place.number >= len(messages):
            raise InputError(f"{self.path} has changed while it was read")
        return self._message(messages[place.number])

    def _next(self) -> tuple[int, int, memoryview] | None:
        """Offset, kind and content of the next record, once all of it is in the file."""
        self._file.seek(self._at)
        head = self._file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return None
        kind, length = _HEAD.unpack(head)
        if length > _LARGEST:
            raise damaged(self.path, remedy="recover what is valid: eldir recover")
        body = self._file.read(length)
        if len(body) < length:
            return None
        at, self._at = self._at, self._at + _HEAD.size + length
        return at, kind, memoryview(body)

    def _messages(self, at: int, records: list[Any]) -> Iterator[LogMessage]:
        number = -1
        for record in records:
            if isinstance(record, Schema):
                self._schemas[record.id] = record.name
            elif isinstance(record, Channel):
                self._channels[record.id] = (record.topic, self._schemas.get(record.schema_id, ""))
            elif isinstance(record, Message):
                number += 1
                topic, _ = self._channels.get(record.channel_id, ("", ""))
                if topic and (self._topics is None or topic in self._topics):
                    yield LogMessage(topic, record.log_time, self._message(record), Place(at, number))

    def _message(self, record: Message) -> Any:
        if self._raw:
            return record.data
        return m.types().deserialize_cdr(record.data, self._channels[record.channel_id][1])

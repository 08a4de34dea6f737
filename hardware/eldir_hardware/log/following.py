"""Follows a log while another program writes it: reads each record as soon as it is in the file.

The writer is not involved. A finished log is read to its end in the same way.
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
from eldir_hardware.log._salvage import get_facts, run_metadata, whole_record
from eldir_hardware.log.mcap_file import MAGIC, find_log
from eldir_hardware.resource import Resource

_HEAD = struct.Struct("<BQ")  # kind of a record, length
_MAX_RECORD = 1 << 28  # a longer record is damaged [bytes]


class MessagePlace(NamedTuple):
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
    place: MessagePlace


class LogFollower(Resource):
    """A log, between `open` and `close` or in a `with`."""

    def __init__(self, path: Path | str, topics: Collection[str] | None = None, raw: bool = False):
        """`topics`: those that `poll` gives; None for all. `raw`: it gives messages as the bytes (CDR) of the
        log."""
        self.path = find_log(Path(path))
        self.attachments: dict[str, bytes] = {}
        """Attached files, as far as the log was read."""
        self.epoch_ns: int | None = None
        """Time of day at the start [ns since 1970]; None before the run begins."""
        self.facts: dict[str, str] = {}
        """What the program wrote about the run, such as the measured air, as far as the log was read."""
        self.is_finished = False
        """Whether the program that wrote the log has finished it."""
        self.damaged = 0
        """Number of chunks and attachments whose checksum is wrong."""
        self._topics, self._raw = topics, raw
        self._position = 0
        self._channels: dict[int, tuple[str, str]] = {}  # topic and type
        self._schemas: dict[int, str] = {}

    def open(self) -> None:
        """Raises `InputError` for a file that is missing or no MCAP log."""
        try:
            self._file: BinaryIO = self.path.open("rb")
        except OSError as error:
            raise not_read(self.path, error) from None
        magic = self._file.read(len(MAGIC))
        if magic and not MAGIC.startswith(magic):
            self._file.close()
            problem, expected = f"{self.path} is not an MCAP log", "a log of `eldir rig drive`"
            raise InputError(problem, code="log.other-file", expected=expected, found="another file")

    def close(self) -> None:
        self._file.close()

    @property
    def is_complete(self) -> bool:
        """Whether the file is finished: no program writes it any more."""
        end = self._file.seek(0, 2)
        self._file.seek(max(end - len(MAGIC), 0))
        return end > 2 * len(MAGIC) and self._file.read() == MAGIC

    def get_type(self, topic: str) -> str:
        """Type of a topic that `poll` gave, such as sensor_msgs/msg/Temperature."""
        return next(kind for name, kind in self._channels.values() if name == topic)

    def poll(self) -> Iterator[LogMessage]:
        """Yield every message since the last call, in the order of the file.

        Consume all of them: the next call continues after the chunk of the last one.
        """
        self._position = max(self._position, len(MAGIC))
        while not self.is_finished and (content := self._next()) is not None:
            position, kind, body = content
            record = whole_record(kind, body)
            if isinstance(record, list):
                yield from self._messages(position, record)
            elif isinstance(record, Attachment):
                self.attachments[record.name] = record.data
            elif isinstance(record, Metadata):
                self.epoch_ns, _ = run_metadata(record)
                self.facts = get_facts(record)
            elif record is not None:
                self.damaged += 1
            self.is_finished = kind == Opcode.DATA_END

    def read(self, place: MessagePlace) -> Any:
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
        self._file.seek(self._position)
        head = self._file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return None
        kind, length = _HEAD.unpack(head)
        if length > _MAX_RECORD:
            raise damaged(self.path, remedy="recover what is valid: eldir recover")
        body = self._file.read(length)
        if len(body) < length:
            return None
        position, self._position = self._position, self._position + _HEAD.size + length
        return position, kind, memoryview(body)

    def _messages(self, position: int, records: list[Any]) -> Iterator[LogMessage]:
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
                    yield LogMessage(
                        topic, record.log_time, self._message(record), MessagePlace(position, number)
                    )

    def _message(self, record: Message) -> Any:
        if self._raw:
            return record.data
        return m.typestore().deserialize_cdr(record.data, self._channels[record.channel_id][1])

"""Repairs a log that was cut off or damaged."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from eldir.core.files import require_new
from eldir.core.version import __version__
from eldir.errors import InputError, empty, not_read, not_written
from eldir_hardware.log import messages as m
from eldir_hardware.log._growing import describe_bag
from eldir_hardware.log._salvage import (
    BrokenRecord,
    CheckedData,
    SalvagedRecord,
    TruncatedChunk,
    UncheckedRecords,
    count_missing,
    get_facts,
    run_metadata,
    valid_records,
    with_crc,
)
from eldir_hardware.log.mcap_file import find_log

_MAX_VIRTUAL_STAMP = 10**15
"""Stamps below this many nanoseconds, twelve days, are a virtual run's."""


@dataclass
class RecoveryReport:
    """What was recovered and what is missing."""

    messages: int = 0
    seconds: float = 0.0
    attachments: tuple[str, ...] = ()
    missing: int = 0
    """Number of missing messages between the ones found."""
    broken: list[str] = field(default_factory=list)
    """Attachments with a wrong checksum, and 'chunk' for each such chunk."""
    unchecked: int = 0
    """Messages that could not be checked: of a last chunk that was cut off, or written without a checksum."""
    epoch_known: bool = True
    """Whether the run's start was found; otherwise the time of the first message is used."""

    @property
    def losses(self) -> str:
        """Description of what is missing."""
        sentences = []
        if self.missing:
            sentences.append(f"{self.missing} messages missing in between")
        if chunks := self.broken.count("chunk"):
            sentences.append(f"{chunks} damaged chunks left out")
        sentences += [f"{name} damaged and left out" for name in self.broken if name != "chunk"]
        if self.unchecked:
            sentences.append(f"{self.unchecked} messages could not be checked")
        if not self.epoch_known:
            sentences.append("the start of the run is unknown, so the time of its first message is used")
        return "; ".join(sentences) or "nothing missing before the end"


def recover_log(log: Path, out: Path) -> RecoveryReport:
    """Write the valid records of `log` to the new log `out`, whole or not at all, and describe its bag.

    Raises `InputError` where there is nothing to recover.
    """
    require_new(out)
    draft = out.with_name(f".{out.name}.draft")
    try:
        data = find_log(log).read_bytes()
    except OSError as error:
        raise not_read(log, error) from None
    if not data:
        raise empty(log, "an MCAP log")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        report = _rewrite(data, log, draft)
        draft.replace(out)
        describe_bag(out)
    except OSError as error:
        raise not_written(out, error) from None
    finally:
        draft.unlink(missing_ok=True)
    return report


class _RecordCollector:
    """Collects records; at the end it knows every channel that any of them names."""

    def __init__(self) -> None:
        self.epochs: list[int] = []
        self.facts: dict[int, dict[str, str]] = {}
        """Other entries of the metadata, by the run's start."""
        self.attachments: dict[str, Attachment] = {}
        self.broken: list[str] = []
        self.messages: list[Message] = []
        self.unchecked = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._metadata_channels: dict[int, tuple[str, str]] = {}
        self._truncated: list[TruncatedChunk] = []

    def add(self, record: SalvagedRecord) -> None:
        """Any record of `valid_records`."""
        if isinstance(record, Attachment):
            self.attachments[record.name] = record
        elif isinstance(record, Metadata):
            epoch, channels = run_metadata(record)
            self.epochs.append(epoch)
            self.facts.setdefault(epoch, {}).update(get_facts(record))
            self._metadata_channels |= channels
        elif isinstance(record, BrokenRecord):
            self.broken.append(record.what)
        elif isinstance(record, TruncatedChunk):
            self._truncated.append(record)
        elif isinstance(record, CheckedData):
            self.unchecked = 0
        elif isinstance(record, UncheckedRecords):
            before = len(self.messages)
            self._keep(record.records)
            self.unchecked += len(self.messages) - before
        else:
            self._keep(record)
            if self._truncated:  # more records follow, so the chunk is damaged and not truncated
                self.broken += ["chunk"] * len(self._truncated)
                self._truncated.clear()

    def finish(self) -> None:
        """After the last record: keep the complete messages of a truncated chunk, unchecked."""
        before = len(self.messages)
        for cut in self._truncated[:1]:
            self._keep(cut.records)
        self.unchecked += len(self.messages) - before

    def _keep(self, records: list[Any]) -> None:
        for inner in records:
            if isinstance(inner, Message):
                self.messages.append(inner)
            elif isinstance(inner, Schema):
                self._schemas[inner.id] = inner
            else:
                self._channels[inner.id] = inner

    def channels(self) -> dict[int, tuple[str, m.MessageType | Schema, dict[str, str]]]:
        """Topic, type and metadata of each channel by its number in the file."""
        known: dict[int, tuple[str, m.MessageType | Schema, dict[str, str]]] = {}
        for number, (topic, name) in self._metadata_channels.items():
            kind = next((k for k in m.MESSAGE_TYPES.values() if k.name == name), m.MessageType(name))
            known[number] = (topic, kind, {"offered_qos_profiles": kind.qos})
        for number, channel in self._channels.items():
            if channel.schema_id in self._schemas:
                known[number] = (channel.topic, self._schemas[channel.schema_id], channel.metadata)
        return known


def _rewrite(data: bytes, log: Path, draft: Path) -> RecoveryReport:
    sorter = _RecordCollector()
    for record in valid_records(data):
        sorter.add(record)
    sorter.finish()
    channels = sorter.channels()
    messages = [x for x in sorter.messages if x.channel_id in channels]
    if not messages and not sorter.attachments:
        raise InputError(
            f"{log} holds nothing to recover",
            code="log.nothing-to-recover",
            expected="an MCAP log",
            found=f"{len(data)} bytes without any",
        )
    stamps = [x.log_time for x in messages]
    numbers: dict[int, list[int]] = {}
    for x in messages:
        numbers.setdefault(x.channel_id, []).append(x.sequence)
    report = RecoveryReport(
        messages=len(messages),
        seconds=(max(stamps) - min(stamps)) * 1e-9 if stamps else 0.0,
        attachments=tuple(sorter.attachments),
        missing=count_missing(numbers),
        broken=sorter.broken,
        unchecked=sorter.unchecked,
        epoch_known=bool(sorter.epochs),
    )
    epoch = max(set(sorter.epochs), key=sorter.epochs.count) if sorter.epochs else _guess_epoch(stamps)
    with draft.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile="ros2", library=f"eldir {__version__}")
        note = {"epoch_ns": str(epoch), "recovered": report.losses} | sorter.facts.get(epoch, {})
        writer.add_metadata(m.METADATA, with_crc(note))
        _write(writer, channels, sorter.attachments, messages)
        writer.finish()
    return report


def _write(
    writer: Writer,
    channels: dict[int, tuple[str, m.MessageType | Schema, dict[str, str]]],
    attachments: dict[str, Attachment],
    messages: list[Message],
) -> None:
    for a in attachments.values():
        writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
    schemas: dict[str, int] = {}
    numbers = {}
    for number, (topic, kind, metadata) in sorted(channels.items()):
        if kind.name not in schemas:
            definition = kind.data if isinstance(kind, Schema) else kind.definition.encode()
            schemas[kind.name] = writer.register_schema(kind.name, "ros2msg", definition)
        numbers[number] = writer.register_channel(topic, "cdr", schemas[kind.name], metadata)
    for x in messages:
        writer.add_message(numbers[x.channel_id], x.log_time, x.data, x.publish_time, x.sequence)


def _guess_epoch(stamps: list[int]) -> int:
    first = min(stamps, default=0)
    return m.VIRTUAL_EPOCH if first < _MAX_VIRTUAL_STAMP else first

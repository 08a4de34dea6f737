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
from eldir_hardware.log import bag
from eldir_hardware.log import messages as m
from eldir_hardware.log.salvage import (
    Broken,
    Checked,
    Cut,
    Found,
    Unchecked,
    facts_of,
    missing,
    run_metadata,
    valid_records,
    with_crc,
)

_SINCE_1970 = 10**15
"""Stamps below this many nanoseconds, twelve days, are a virtual run's."""


@dataclass
class Recovered:
    """What was recovered, and what is missing."""

    messages: int = 0
    seconds: float = 0.0
    attachments: tuple[str, ...] = ()
    missing: int = 0
    """Number of missing messages between the ones found."""
    broken: list[str] = field(default_factory=list)
    """Attachments with a wrong checksum, and 'chunk' for each such chunk."""
    unchecked: int = 0
    """Messages that could not be checked: of a last chunk that was cut off, or written without a checksum."""
    epoch_found: bool = True
    """Whether the run's start was found; otherwise the time of the first message is used."""

    @property
    def losses(self) -> str:
        """Description of what is missing."""
        said = []
        if self.missing:
            said.append(f"{self.missing} messages missing in between")
        if chunks := self.broken.count("chunk"):
            said.append(f"{chunks} damaged chunks left out")
        said += [f"{name} damaged and left out" for name in self.broken if name != "chunk"]
        if self.unchecked:
            said.append(f"{self.unchecked} messages could not be checked")
        if not self.epoch_found:
            said.append("the start of the run is unknown, so the time of its first message is used")
        return "; ".join(said) or "nothing missing before the end"


def recover_log(log: Path, out: Path) -> Recovered:
    """Write the valid records of `log` to the new log `out`, whole or not at all, and describe its bag.

    Raises `InputError` where there is nothing to recover.
    """
    require_new(out)
    draft = out.with_name(f".{out.name}.draft")
    try:
        data = bag.log_in(log).read_bytes()
    except OSError as error:
        raise not_read(log, error) from None
    if not data:
        raise empty(log, "an MCAP log")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        found = _rewrite(data, log, draft)
        draft.replace(out)
        bag.describe(out)
    except OSError as error:
        raise not_written(out, error) from None
    finally:
        draft.unlink(missing_ok=True)
    return found


class _Sorter:
    """Collects records; at the end it knows every channel that any of them names."""

    def __init__(self) -> None:
        self.epochs: list[int] = []
        self.facts: dict[int, dict[str, str]] = {}
        """What the metadata says besides, by the run's start."""
        self.attachments: dict[str, Attachment] = {}
        self.broken: list[str] = []
        self.messages: list[Message] = []
        self.unchecked = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._noted: dict[int, tuple[str, str]] = {}
        self._cut: list[Cut] = []

    def take(self, record: Found) -> None:
        """Any record of `valid_records`."""
        if isinstance(record, Attachment):
            self.attachments[record.name] = record
        elif isinstance(record, Metadata):
            epoch, channels = run_metadata(record)
            self.epochs.append(epoch)
            self.facts.setdefault(epoch, {}).update(facts_of(record))
            self._noted |= channels
        elif isinstance(record, Broken):
            self.broken.append(record.what)
        elif isinstance(record, Cut):
            self._cut.append(record)
        elif isinstance(record, Checked):
            self.unchecked = 0
        elif isinstance(record, Unchecked):
            before = len(self.messages)
            self._keep(record.records)
            self.unchecked += len(self.messages) - before
        else:
            self._keep(record)
            if self._cut:  # there is more after it, so it was not the file's end that cut it
                self.broken += ["chunk"] * len(self._cut)
                self._cut.clear()

    def end(self) -> None:
        """No more records: keep the messages of a last chunk before the cut, unchecked."""
        before = len(self.messages)
        for cut in self._cut[:1]:
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

    def channels(self) -> dict[int, tuple[str, m.Kind | Schema, dict[str, str]]]:
        """Topic, type and metadata of each channel by its number in the file."""
        known: dict[int, tuple[str, m.Kind | Schema, dict[str, str]]] = {}
        for number, (topic, name) in self._noted.items():
            kind = next((k for k in m.KINDS.values() if k.name == name), m.Kind(name))
            known[number] = (topic, kind, {"offered_qos_profiles": kind.qos})
        for number, channel in self._channels.items():
            if channel.schema_id in self._schemas:
                known[number] = (channel.topic, self._schemas[channel.schema_id], channel.metadata)
        return known


def _rewrite(data: bytes, log: Path, draft: Path) -> Recovered:
    sorter = _Sorter()
    for record in valid_records(data):
        sorter.take(record)
    sorter.end()
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
    found = Recovered(
        messages=len(messages),
        seconds=(max(stamps) - min(stamps)) * 1e-9 if stamps else 0.0,
        attachments=tuple(sorter.attachments),
        missing=missing(numbers),
        broken=sorter.broken,
        unchecked=sorter.unchecked,
        epoch_found=bool(sorter.epochs),
    )
    epoch = max(set(sorter.epochs), key=sorter.epochs.count) if sorter.epochs else _guess(stamps)
    with draft.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile="ros2", library=f"eldir {__version__}")
        note = {"epoch_ns": str(epoch), "recovered": found.losses} | sorter.facts.get(epoch, {})
        writer.add_metadata(m.METADATA, with_crc(note))
        _write(writer, channels, sorter.attachments, messages)
        writer.finish()
    return found


def _write(
    writer: Writer,
    channels: dict[int, tuple[str, m.Kind | Schema, dict[str, str]]],
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


def _guess(stamps: list[int]) -> int:
    first = min(stamps, default=0)
    return m.VIRTUAL_EPOCH if first < _SINCE_1970 else first

"""Finds the valid records in the bytes of a damaged MCAP file.

Only checksums are trusted: a chunk, an attachment and each copy of our metadata has one. Where a record is
damaged, the next is searched at every byte, so a wrong length loses nothing else. Checksums and chunks are
optional in MCAP: what has none counts only where records follow one another without a break, as unchecked.
"""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from typing import Any

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Message, Metadata, Schema

from eldir_hardware.log import messages as m

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = re.compile(rb"[\x06\x09\x0c].{5}\x00{3}", re.DOTALL)
"""A chunk, an attachment or metadata of less than a terabyte: kind, then length in eight bytes."""
_OURS = ("epoch_ns", "channels", "recovered", "crc32")
"""What a log itself needs of its metadata, or says of its repair."""
_FRAMING = 9
_CHUNK = struct.Struct("<QQQII")  # start, end, size, sum, length of the compression's name
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time


@dataclass(frozen=True)
class Cut:
    """A chunk that the file's end cuts off; `records` are those before the cut."""

    records: list[Any]


@dataclass(frozen=True)
class Broken:
    """A chunk or attachment with a wrong checksum."""

    what: str


@dataclass(frozen=True)
class Unchecked:
    """Records of a chunk without a checksum, or one outside of chunks."""

    records: list[Any]


@dataclass(frozen=True)
class Checked:
    """The checksum of all data before is right."""


Found = Attachment | Metadata | list[Any] | Cut | Broken | Unchecked | Checked


def valid_records(data: bytes) -> Iterator[Found]:
    """Attachments, our metadata, the records of each chunk, and those outside of chunks, in file order."""
    at = len(_MAGIC) if data.startswith(_MAGIC) else 0
    in_step = at > 0
    while at < len(data):
        if in_step and (end := _end_of(data, at)) is not None and data[at] not in _READERS:
            yield from _outside(data, at, end)
            at = end
            continue
        found = _HEAD.match(data, at) if in_step else None
        in_step = found is not None
        found = found or _HEAD.search(data, at)
        if found is None:
            return
        start = found.start()
        (length,) = struct.unpack_from("<Q", data, start + 1)
        body = start + _FRAMING
        content = memoryview(data)[body : body + length]
        cut = body + length > len(data)  # or its length is wrong
        record = _READERS[Opcode(data[start])](content, cut, in_step)
        if record is not None:
            yield record
        whole = not cut and not isinstance(record, Broken) and (record is not None or in_step)
        at, in_step = (body + length, True) if whole else (start + 1, False)


def _end_of(data: bytes, at: int) -> int | None:
    """Where the record at this byte ends, if another record or the file's end is there."""
    if not 0 < data[at] <= max(Opcode) or at + _FRAMING > len(data):
        return None
    end = at + _FRAMING + int(struct.unpack_from("<Q", data, at + 1)[0])
    follows = data[end : end + 1]
    sound = end <= len(data) and (not follows or 0 < follows[0] <= max(Opcode) or data[end:] == _MAGIC)
    return end if sound else None


def _outside(data: bytes, at: int, end: int) -> Iterator[Unchecked | Checked]:
    """A record outside of chunks."""
    if data[at] == Opcode.DATA_END:
        (wanted,) = struct.unpack_from("<I", data, at + _FRAMING)
        if wanted and wanted == zlib.crc32(memoryview(data)[:at]):
            yield Checked()
        return
    try:
        records = list(_records(data[at:end]))
    except Exception:  # damaged bytes are no record, however that shows
        return
    if records:
        yield Unchecked(records)


def whole_record(kind: int, content: memoryview) -> Attachment | Metadata | list[Any] | Cut | Broken | None:
    """One complete record, as `valid_records` gives it; None for one of another kind."""
    reader = _READERS.get(Opcode(kind)) if kind in set(Opcode) else None
    found = None if reader is None else reader(content, False, True)
    return found.records if isinstance(found, Unchecked) else found


def run_metadata(metadata: Metadata) -> tuple[int, dict[int, tuple[str, str]]]:
    """Time of day at the start [ns], and topic and type of each channel, from our own metadata."""
    channels = json.loads(metadata.metadata.get("channels", "{}"))
    return int(metadata.metadata["epoch_ns"]), {int(k): (v[0], v[1]) for k, v in channels.items()}


def facts_of(metadata: Metadata) -> dict[str, str]:
    """What our own metadata says besides: digests of the run's files, why a mismatch was accepted."""
    return {k: v for k, v in metadata.metadata.items() if k not in _OURS}


def with_crc(values: dict[str, str]) -> dict[str, str]:
    """Values of a metadata record with a checksum of ours, because such records have none."""
    return values | {"crc32": f"{zlib.crc32(json.dumps(values).encode()):08x}"}


def _metadata(content: memoryview, cut: bool, in_step: bool) -> Metadata | None:
    name = m.METADATA.encode()
    if cut or bytes(content[: 4 + len(name)]) != struct.pack("<I", len(name)) + name:
        return None
    try:
        record = Metadata.read(ReadDataStream(BytesIO(content)))
        values = dict(record.metadata)
        values.pop("crc32", None)
        return record if with_crc(values) == record.metadata and "epoch_ns" in values else None
    except Exception:  # damaged bytes are not this record, however that shows
        return None


def _attachment(content: memoryview, cut: bool, in_step: bool) -> Attachment | Broken | None:
    try:
        record = Attachment.read(ReadDataStream(BytesIO(content)))
    except Exception:  # as above
        return None
    strings = len(record.name.encode()) + len(record.media_type.encode())
    if cut or 16 + 4 + 4 + strings + 8 + len(record.data) + 4 != len(content):
        return None
    (wanted,) = struct.unpack("<I", content[-4:])
    if wanted != zlib.crc32(content[:-4]) and not (wanted == 0 and in_step):
        return Broken(record.name)
    return record


def _chunk(content: memoryview, cut: bool, in_step: bool) -> list[Any] | Cut | Broken | Unchecked | None:
    try:
        start, end, size, wanted, named = _CHUNK.unpack_from(content)
        kind = str(content[_CHUNK.size : _CHUNK.size + named], "ascii")
        (length,) = struct.unpack_from("<Q", content, _CHUNK.size + named)
        data = bytes(content[_CHUNK.size + named + 8 :][:length])
    except (struct.error, UnicodeDecodeError):
        return None
    whole = _CHUNK.size + named + 8 + length == len(content)
    if kind not in ("", "zstd", "lz4") or not (whole or cut):
        return None
    try:
        plain = _decompressed(kind, data)
    except Exception:  # decompressors fail in many ways
        plain = b""
    if len(plain) == size and zlib.crc32(plain) == wanted:
        return list(_records(plain))
    if len(plain) == size and wanted == 0 and in_step:
        return Unchecked(list(_records(plain)))
    if not cut:
        return Broken("chunk")
    before = [r for r in _records(plain) if not isinstance(r, Message) or start <= r.log_time <= end]
    return Cut(before) if before else None


def _decompressed(kind: str, data: bytes) -> bytes:
    """Decompress a stream as far as it goes; it may be cut off."""
    if kind == "zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    if kind == "lz4":
        return lz4.frame.LZ4FrameDecompressor().decompress(data)
    return data


def _records(plain: bytes) -> Iterator[Schema | Channel | Message]:
    """Whole records of a chunk."""
    at = 0
    while at + _FRAMING <= len(plain):
        kind, (length,) = plain[at], struct.unpack_from("<Q", plain, at + 1)
        content = plain[at + _FRAMING : at + _FRAMING + length]
        if len(content) < length:
            return
        if kind == Opcode.MESSAGE:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(content)
            yield Message(channel, log_time, content[_MESSAGE.size :], publish_time, sequence)
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            reader = Schema if kind == Opcode.SCHEMA else Channel
            yield reader.read(ReadDataStream(BytesIO(content)))
        at += _FRAMING + length


_READERS = {Opcode.CHUNK: _chunk, Opcode.ATTACHMENT: _attachment, Opcode.METADATA: _metadata}


def missing(sequences: dict[int, list[int]]) -> int:
    """Number of missing messages, counted from the gaps in the sequence numbers."""
    return sum(max(b - a - 1, 0) for s in sequences.values() for a, b in pairwise(sorted(s)))

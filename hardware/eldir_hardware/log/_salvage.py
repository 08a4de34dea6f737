"""Finds the valid records in the bytes of a damaged MCAP file.

Only checksums are trusted: a chunk, an attachment and each copy of our metadata has one. Where a record is
damaged, the next is searched at every byte, so a wrong length loses nothing else. Checksums and chunks are
optional in MCAP: records without one count only if they follow each other without a gap, as unchecked.
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
from eldir_hardware.log.mcap_file import MAGIC

_RECORD_START = re.compile(rb"[\x06\x09\x0c].{5}\x00{3}", re.DOTALL)
"""A chunk, an attachment or metadata of less than a terabyte: kind, then length in eight bytes."""
_OWN_KEYS = ("epoch_ns", "channels", "recovered", "crc32")
"""Metadata keys of the log itself and of its repair."""
_HEADER_SIZE = 9
_CHUNK = struct.Struct("<QQQII")  # start, end, size, sum, length of the compression's name
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time


@dataclass(frozen=True)
class TruncatedChunk:
    """A chunk that is truncated at the end of the file, with its complete records."""

    records: list[Any]


@dataclass(frozen=True)
class BrokenRecord:
    """A chunk or attachment with a wrong checksum."""

    what: str


@dataclass(frozen=True)
class UncheckedRecords:
    """Records of a chunk without a checksum, or one outside of chunks."""

    records: list[Any]


@dataclass(frozen=True)
class CheckedData:
    """Marks that the checksum of all earlier data is correct."""


SalvagedRecord = (
    Attachment | Metadata | list[Any] | TruncatedChunk | BrokenRecord | UncheckedRecords | CheckedData
)


def valid_records(data: bytes) -> Iterator[SalvagedRecord]:
    """Attachments, our metadata, the records of each chunk, and those outside of chunks, in file order."""
    position = len(MAGIC) if data.startswith(MAGIC) else 0
    is_aligned = position > 0
    while position < len(data):
        if is_aligned and (end := _find_end(data, position)) is not None and data[position] not in _READERS:
            yield from _read_outside_chunks(data, position, end)
            position = end
            continue
        found = _RECORD_START.match(data, position) if is_aligned else None
        is_aligned = found is not None
        found = found or _RECORD_START.search(data, position)
        if found is None:
            return
        start = found.start()
        (length,) = struct.unpack_from("<Q", data, start + 1)
        body = start + _HEADER_SIZE
        content = memoryview(data)[body : body + length]
        is_truncated = body + length > len(data)  # or its length is wrong
        record = _READERS[Opcode(data[start])](content, is_truncated, is_aligned)
        if record is not None:
            yield record
        whole = (
            not is_truncated and not isinstance(record, BrokenRecord) and (record is not None or is_aligned)
        )
        position, is_aligned = (body + length, True) if whole else (start + 1, False)


def _find_end(data: bytes, position: int) -> int | None:
    """Where the record at this byte ends, if another record or the file's end is there."""
    if not 0 < data[position] <= max(Opcode) or position + _HEADER_SIZE > len(data):
        return None
    end = position + _HEADER_SIZE + int(struct.unpack_from("<Q", data, position + 1)[0])
    follows = data[end : end + 1]
    is_valid = end <= len(data) and (not follows or 0 < follows[0] <= max(Opcode) or data[end:] == MAGIC)
    return end if is_valid else None


def _read_outside_chunks(data: bytes, position: int, end: int) -> Iterator[UncheckedRecords | CheckedData]:
    """A record outside of chunks."""
    if data[position] == Opcode.DATA_END:
        (expected_crc,) = struct.unpack_from("<I", data, position + _HEADER_SIZE)
        if expected_crc and expected_crc == zlib.crc32(memoryview(data)[:position]):
            yield CheckedData()
        return
    try:
        records = list(_parse_records(data[position:end]))
    except Exception:  # damaged bytes raise many kinds of errors
        return
    if records:
        yield UncheckedRecords(records)


def whole_record(
    kind: int, content: memoryview
) -> Attachment | Metadata | list[Any] | TruncatedChunk | BrokenRecord | None:
    """One complete record, as `valid_records` gives it; None for one of another kind."""
    reader = _READERS.get(Opcode(kind)) if kind in set(Opcode) else None
    found = None if reader is None else reader(content, False, True)
    return found.records if isinstance(found, UncheckedRecords) else found


def run_metadata(metadata: Metadata) -> tuple[int, dict[int, tuple[str, str]]]:
    """Time of day at the start [ns], and topic and type of each channel, from our own metadata."""
    channels = json.loads(metadata.metadata.get("channels", "{}"))
    return int(metadata.metadata["epoch_ns"]), {int(k): (v[0], v[1]) for k, v in channels.items()}


def get_facts(metadata: Metadata) -> dict[str, str]:
    """The other entries of our metadata: digests of the run's files, why a mismatch was accepted."""
    return {k: v for k, v in metadata.metadata.items() if k not in _OWN_KEYS}


def with_crc(values: dict[str, str]) -> dict[str, str]:
    """The values of a metadata record with an added checksum, as MCAP has none for them."""
    return values | {"crc32": f"{zlib.crc32(json.dumps(values).encode()):08x}"}


def _metadata(content: memoryview, is_truncated: bool, is_aligned: bool) -> Metadata | None:
    name = m.METADATA.encode()
    if is_truncated or bytes(content[: 4 + len(name)]) != struct.pack("<I", len(name)) + name:
        return None
    try:
        record = Metadata.read(ReadDataStream(BytesIO(content)))
        values = dict(record.metadata)
        values.pop("crc32", None)
        return record if with_crc(values) == record.metadata and "epoch_ns" in values else None
    except Exception:  # damaged bytes raise many kinds of errors
        return None


def _attachment(
    content: memoryview, is_truncated: bool, is_aligned: bool
) -> Attachment | BrokenRecord | None:
    try:
        record = Attachment.read(ReadDataStream(BytesIO(content)))
    except Exception:  # as above
        return None
    strings = len(record.name.encode()) + len(record.media_type.encode())
    if is_truncated or 16 + 4 + 4 + strings + 8 + len(record.data) + 4 != len(content):
        return None
    (expected_crc,) = struct.unpack("<I", content[-4:])
    if expected_crc != zlib.crc32(content[:-4]) and not (expected_crc == 0 and is_aligned):
        return BrokenRecord(record.name)
    return record


def _chunk(
    content: memoryview, is_truncated: bool, is_aligned: bool
) -> list[Any] | TruncatedChunk | BrokenRecord | UncheckedRecords | None:
    try:
        start, end, size, expected_crc, name_length = _CHUNK.unpack_from(content)
        kind = str(content[_CHUNK.size : _CHUNK.size + name_length], "ascii")
        (length,) = struct.unpack_from("<Q", content, _CHUNK.size + name_length)
        data = bytes(content[_CHUNK.size + name_length + 8 :][:length])
    except (struct.error, UnicodeDecodeError):
        return None
    whole = _CHUNK.size + name_length + 8 + length == len(content)
    if kind not in ("", "zstd", "lz4") or not (whole or is_truncated):
        return None
    try:
        plain = _decompress(kind, data)
    except Exception:  # decompressors fail in many ways
        plain = b""
    if len(plain) == size and zlib.crc32(plain) == expected_crc:
        return list(_parse_records(plain))
    if len(plain) == size and expected_crc == 0 and is_aligned:
        return UncheckedRecords(list(_parse_records(plain)))
    if not is_truncated:
        return BrokenRecord("chunk")
    before = [r for r in _parse_records(plain) if not isinstance(r, Message) or start <= r.log_time <= end]
    return TruncatedChunk(before) if before else None


def _decompress(kind: str, data: bytes) -> bytes:
    """Decompress a stream as far as it goes; it may be cut off."""
    if kind == "zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    if kind == "lz4":
        return lz4.frame.LZ4FrameDecompressor().decompress(data)
    return data


def _parse_records(plain: bytes) -> Iterator[Schema | Channel | Message]:
    """Whole records of a chunk."""
    position = 0
    while position + _HEADER_SIZE <= len(plain):
        kind, (length,) = plain[position], struct.unpack_from("<Q", plain, position + 1)
        content = plain[position + _HEADER_SIZE : position + _HEADER_SIZE + length]
        if len(content) < length:
            return
        if kind == Opcode.MESSAGE:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(content)
            yield Message(channel, log_time, content[_MESSAGE.size :], publish_time, sequence)
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            reader = Schema if kind == Opcode.SCHEMA else Channel
            yield reader.read(ReadDataStream(BytesIO(content)))
        position += _HEADER_SIZE + length


_READERS = {Opcode.CHUNK: _chunk, Opcode.ATTACHMENT: _attachment, Opcode.METADATA: _metadata}


def count_missing(sequences: dict[int, list[int]]) -> int:
    """Number of missing messages, counted from the gaps in the sequence numbers."""
    return sum(max(b - a - 1, 0) for s in sequences.values() for a, b in pairwise(sorted(s)))

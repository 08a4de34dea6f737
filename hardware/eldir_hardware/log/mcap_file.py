"""MCAP files of runs: where they are, their checksums, and their contents without interpretation."""

from __future__ import annotations

import hashlib
import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from mcap.exceptions import InvalidMagic
from mcap.reader import McapReader, NonSeekingReader, SeekingReader
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema, Statistics
from mcap.summary import Summary

from eldir.core.files import read_file
from eldir.core.yaml_files import parse_foreign_yaml
from eldir.errors import EldirError, InputError, damaged, empty, not_read
from eldir_hardware.images.file_kind import require_log
from eldir_hardware.log import messages as m

MAGIC = b"\x89MCAP0\r\n"
"""Magic bytes at the beginning and the end of an MCAP file."""
BAG_METADATA = "metadata.yaml"
"""File that makes the folder of a log a bag of rosbag2."""
_MAX_BAG_METADATA = 1 << 20  # [bytes]
_FINGERPRINT_BYTES = 1 << 16  # at the end of a log


def find_log(path: Path) -> Path:
    """The log at a path: the file itself, or the log that a bag folder describes."""
    if not path.is_dir():
        require_log(path)
        return path
    if not (path / BAG_METADATA).exists():
        raise InputError(
            f"{path} is not a bag folder",
            code="bag.no-metadata",
            expected=f"a log and its {BAG_METADATA}",
            remedy="name the .mcap file itself",
        )
    remedy = "name the .mcap file itself"
    values = parse_foreign_yaml(
        read_file(path / BAG_METADATA, _MAX_BAG_METADATA), str(path / BAG_METADATA), remedy
    )
    try:
        names = values["rosbag2_bagfile_information"]["relative_file_paths"]
    except (KeyError, TypeError) as error:
        raise damaged(path / BAG_METADATA, found=type(error).__name__, remedy=remedy) from None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise damaged(path / BAG_METADATA, found=f"relative_file_paths: {names!r:.40}", remedy=remedy)
    if len(names) != 1:
        raise InputError(
            f"{path} holds several files",
            code="bag.several-files",
            expected="one log",
            found=f"{len(names)}",
            remedy=remedy,
        )
    log = path / Path(names[0]).name
    require_log(log)
    return log


def fingerprint(log: Path) -> str:
    """SHA-256 of a log's size and of its last 64 KiB, in hexadecimal.

    MCAP ends with an index of all chunks and a checksum of all that comes before, so two logs differ there. A
    log of 20 MB is not read for it. Raises `OSError` where it cannot be read.
    """
    with log.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _FINGERPRINT_BYTES))
        return hashlib.sha256(f"{size} ".encode() + file.read()).hexdigest()


@dataclass(frozen=True)
class LogContents:
    """A summary of a log, without its messages."""

    metadata: dict[str, str]
    """Metadata record of eldir."""
    attachments: dict[str, bytes]
    topics: dict[str, int]
    """Number of messages of each topic."""
    end_ns: int
    """Time of day of the last message [ns since 1970]."""

    @property
    def epoch_ns(self) -> int:
        """Time of day at the start [ns since 1970]."""
        return int(self.metadata["epoch_ns"])


def read_contents(path: Path) -> LogContents:
    """Read the summary of a log and check all of its bytes. Raises `InputError` as `read_log` does."""
    with _open_reader(path, check_all=True) as reader:
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


def iter_messages(path: Path, topics: list[str]) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, time stamp [ns] and message, in the order of time."""
    if not topics:
        return
    with _open_reader(path) as reader:
        for schema, channel, record in reader.iter_messages(topics):
            if schema is not None:
                yield (
                    channel.topic,
                    record.log_time,
                    m.typestore().deserialize_cdr(record.data, schema.name),
                )


@contextmanager
def _open_reader(path: Path, check_all: bool = False) -> Iterator[McapReader]:
    """Open a log; `check_all`: check all of its bytes. Raises `InputError` that names the problem."""
    try:
        with path.open("rb") as file:
            if not file.read(8):
                raise empty(path, "an MCAP log")
            if check_all:
                _require_checksums(file)
            file.seek(0)
            indexed = SeekingReader(file, validate_crcs=True)
            yield indexed if _is_complete(indexed.get_summary()) else _LinearReader(file)
    except InvalidMagic:
        raise InputError(
            f"{path} is not a complete MCAP log",
            code="log.not-whole",
            expected="the magic bytes of MCAP at its beginning and end",
            found="another kind of file, or a log that was cut off",
            remedy="if the log was cut off: eldir recover",
        ) from None
    except OSError as error:
        raise not_read(path, error) from None
    except EldirError:
        raise
    except Exception as error:  # parsers and decompressors fail in many ways on damaged bytes
        found, remedy = f"{type(error).__name__}: {error}", "recover the valid records: eldir recover"
        raise damaged(path, "a complete MCAP log", found, remedy) from None


def _require_checksums(file: BinaryIO) -> None:
    """Compare the sums at the end of the data and of the summary; readers leave these two out.

    The file ends with: a record (13 bytes) that holds the sum of the data, the summary, and a
    footer of which the last 28 bytes are where the summary starts (8), an offset (8), the sum of
    the summary (4) and the magic (8).
    """
    end = file.seek(0, os.SEEK_END) - 28
    if end < 0:
        raise InvalidMagic(b"")
    file.seek(end)
    summary, _, summary_sum, magic = struct.unpack("<QQI8s", file.read(28))
    if magic != MAGIC:
        raise InvalidMagic(magic)
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
            raise ValueError("wrong checksum")


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

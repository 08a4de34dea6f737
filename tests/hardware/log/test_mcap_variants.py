"""Logs as other programs rewrite them: MCAP's indices, counts, repeats, chunks and checksums are optional."""

from __future__ import annotations

import json
import zlib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

from eldir.errors import InputError
from eldir_app.application import application
from eldir_hardware.log import messages as m
from eldir_hardware.log.mcap_file import read_contents
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recover import RecoveryReport, recover_log
from tests.hardware.emulated_rigs import in_turn
from tests.hardware.log.damaged_logs import messages, record
from tests.raised import raises

VARIANTS: dict[str, dict[str, Any]] = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "not compressed": {"compression": CompressionType.NONE},
    "small chunks": {"chunk_size": 2000},
    "no chunks": {"use_chunking": False},
    "no statistics": {"use_statistics": False},
    "no summary offsets": {"use_summary_offsets": False},
    "no indices": {"index_types": IndexType.NONE},
    "chunk indices only": {"index_types": IndexType.CHUNK},
    "attachment indices only": {"index_types": IndexType.ATTACHMENT},
    "no metadata index": {"index_types": IndexType.ALL & ~IndexType.METADATA},
    "no message indices": {"index_types": IndexType.ALL & ~IndexType.MESSAGE},
    "no repeated channels": {"repeat_channels": False},
    "no repeated schemas": {"repeat_schemas": False},
    "no checksums": {"enable_crcs": False, "enable_data_crcs": False},
    "a checksum of the data": {"enable_data_crcs": True},
    "no summary": {
        "repeat_channels": False, "repeat_schemas": False, "use_statistics": False,
        "use_summary_offsets": False, "index_types": IndexType.NONE,
    },
    "nothing optional": {
        "repeat_channels": False, "repeat_schemas": False, "use_statistics": False, "use_chunking": False,
        "use_summary_offsets": False, "index_types": IndexType.NONE, "enable_crcs": False,
    },
    "no chunks, checked": {"use_chunking": False, "enable_data_crcs": True},
}  # fmt: skip
UNCHECKED = ("no chunks", "no checksums", "nothing optional")
RECOVERED = (*UNCHECKED, "lz4", "small chunks", "no summary")


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("original") / "log.mcap", seconds=4.0)


def rewrite(original: Path, out: Path, how: dict[str, Any], backwards: bool = False) -> Path:
    """The same records, written by the mcap library."""
    with original.open("rb") as file, out.open("wb") as target:
        reader = make_reader(file)
        found = list(reader.iter_messages())
        writer = Writer(target, **how)
        writer.start(profile="ros2", library="other tool")
        for entry in reader.iter_metadata():
            writer.add_metadata(entry.name, entry.metadata)
        for a in reader.iter_attachments():
            writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
        numbers: dict[str, int] = {}
        for schema, channel, message in reversed(found) if backwards else found:
            assert schema is not None
            if channel.topic not in numbers:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, kind, channel.metadata
                )
            writer.add_message(
                numbers[channel.topic], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()
    return out


def assert_same(log: Path, original: Path) -> None:
    """Messages, attachments, metadata, counts and times are those of the original."""
    with log.open("rb") as file:  # in the order of the file: the library's other reader needs the repeats
        found = {(c.topic, x.log_time, x.data) for _, c, x in NonSeekingReader(file).iter_messages()}
    assert found == messages(original)
    before, after = read_log(original), read_log(log)
    assert after.attachments == before.attachments and len(after.attachments) == 2
    assert after.epoch_ns == before.epoch_ns
    assert after.frame_count == before.frame_count == 40
    for name in ("relay_times", "relays", "temperature_times", "temperatures"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    assert after.tracks == before.tracks and after.statuses == before.statuses
    pairs = zip(after.pictures, before.pictures, strict=True)
    assert all(a[0] == b[0] and bytes(a[1]) == bytes(b[1]) for a, b in pairs)
    assert {**read_contents(log).topics} == {**read_contents(original).topics}
    assert read_contents(log).end_ns == read_contents(original).end_ns


@pytest.mark.parametrize(("name", "backwards"), in_turn([*VARIANTS], [False, True]))
def test_a_log_that_leaves_out_optional_parts_is_read(original, tmp_path, name, backwards) -> None:
    assert_same(rewrite(original, tmp_path / "other.mcap", VARIANTS[name], backwards), original)


@pytest.mark.parametrize(
    "name", [n if n in RECOVERED else pytest.param(n, marks=pytest.mark.stress) for n in VARIANTS]
)
def test_it_is_recovered_and_foreign_readers_open_it(original, tmp_path, name) -> None:
    log = rewrite(original, tmp_path / "other.mcap", VARIANTS[name])
    out = tmp_path / "bag" / "log.mcap"
    words = ["recover", str(log), "--out", str(out)]
    assert CliRunner().invoke(application(words[0]), words).exit_code == 0
    assert_same(out, original)
    said = read_log(out).recovered
    total = sum(read_contents(original).topics.values())
    unchecked = name in UNCHECKED
    assert said == (
        f"{total} messages could not be checked" if unchecked else "nothing missing before the end"
    )
    with AnyReader([out.parent]) as bag:
        counts = Counter(connection.topic for connection, _, raw in bag.messages())
        assert counts == read_contents(original).topics


@pytest.mark.parametrize(
    "name",
    [
        "no chunks",
        "small chunks",
        "nothing optional",
        *(pytest.param(n, marks=pytest.mark.stress) for n in ("no checksums", "lz4")),
    ],
)
def test_cut_at_any_byte_it_holds_what_was_before(original, tmp_path, name) -> None:
    data = rewrite(original, tmp_path / "other.mcap", VARIANTS[name] | {"chunk_size": 2000}).read_bytes()
    every, cut = messages(original), tmp_path / "cut.mcap"
    for size in np.random.default_rng(3).integers(len(data) // 3, len(data), 6).tolist():
        cut.write_bytes(data[:size])
        out = tmp_path / f"{size}.mcap"
        found = recover_log(cut, out)
        kept = messages(out)
        assert kept <= every and len(kept) == found.messages and found.missing == 0
        assert read_log(out).attachments == read_log(original).attachments
        # Whatever was complete before the cut is there: all of its bytes but a chunk, or one message.
        inside = {x for x in every if data[:size].find(x[2]) >= 0} if name == "no chunks" else set()
        assert len(inside - kept) <= 1
        with raises(InputError, "log.not-whole"):
            read_log(cut)


@pytest.mark.parametrize("name", ["no chunks", "nothing optional", "small chunks", "no checksums"])
def test_damage_makes_nothing_up(original, tmp_path, name) -> None:
    """A length is overwritten in the middle: what comes after may be lost, but nothing is made up."""
    data = bytearray(rewrite(original, tmp_path / "other.mcap", VARIANTS[name]).read_bytes())
    middle = len(data) // 2
    data[middle : middle + 64] = np.random.default_rng(4).bytes(64)
    (tmp_path / "damaged.mcap").write_bytes(data)
    try:
        found: RecoveryReport | None = recover_log(tmp_path / "damaged.mcap", tmp_path / "log.mcap")
    except InputError:
        found = None
    if found is not None:
        wrong = messages(tmp_path / "log.mcap") - messages(original)
        assert len(wrong) <= (1 if found.unchecked else 0), "only one without a checksum may hold wrong bytes"


def test_damage_is_told_where_there_is_a_checksum(original, tmp_path) -> None:
    for name in ("no statistics", "no repeated channels", "no chunks, checked"):
        log = rewrite(original, tmp_path / f"{name}.mcap", VARIANTS[name])
        data = bytearray(log.read_bytes())
        compressed = data.find(b"\x28\xb5\x2f\xfd")  # zstd's magic: the indices after it have no checksum
        data[compressed + 300 if compressed > 0 else len(data) // 2] ^= 0x10
        log.write_bytes(data)
        with raises(InputError, "file.damaged"):
            read_log(log)


def test_runs_lists_them_as_sound(original, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "logs").mkdir()
    for number, how in enumerate(VARIANTS.values()):
        rewrite(original, tmp_path / "logs" / f"{number}.mcap", how)
    result = CliRunner().invoke(application("runs"), ["runs", str(tmp_path / "logs"), "--json"])
    runs = json.loads(result.stdout)["runs"]
    assert len(runs) == len(VARIANTS)
    assert {run["frames"] for run in runs} == {40}
    assert not any("MCAP" in json.dumps(run.get("damage", "")) for run in runs)


def test_two_channels_of_one_topic_are_counted_together(original, tmp_path) -> None:
    """As a program that merges logs leaves them."""
    log = tmp_path / "merged.mcap"
    with original.open("rb") as file, log.open("wb") as target:
        reader, writer = make_reader(file), Writer(target)
        writer.start(profile="ros2", library="other tool")
        for entry in reader.iter_metadata():
            writer.add_metadata(entry.name, entry.metadata)
        for i, (schema, channel, message) in enumerate(reader.iter_messages([m.IMAGE])):
            kind = writer.register_schema(schema.name, schema.encoding, schema.data)
            metadata = channel.metadata | {"part": str(i % 2)}
            number = writer.register_channel(channel.topic, "cdr", kind, metadata)
            writer.add_message(number, message.log_time, message.data, message.publish_time, i)
        writer.finish()
    assert read_log(log).frame_count == 40 and len(list(read_log(log).pictures)) == 40
    assert zlib.crc32(next(iter(read_log(log).pictures))[1]) == zlib.crc32(
        next(iter(read_log(original).pictures))[1]
    )

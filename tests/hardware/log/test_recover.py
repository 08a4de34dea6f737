"""Logs that were killed, cut and damaged: what `eldir recover` gets back, and that it makes nothing up."""

from __future__ import annotations

import json
import os
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from eldir.errors import EldirError, InputError
from eldir_app.catalogue.facts import read_facts
from eldir_app.commands.recover import recover as recover_command
from eldir_hardware.log.mcap_file import find_log, read_contents
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.log.recover import recover_log
from tests.hardware.log.damaged_logs import kill_and_recover, messages, record
from tests.hardware.log.log_contents import EPOCH, NAMES, POSITIONS, picture
from tests.paths import ROOT
from tests.raised import raises


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("whole") / "log.mcap")


def opens_everywhere(path: Path) -> None:
    """By us, by the mcap reader with its check sums, and as a bag by rosbags."""
    read_log(path)
    with path.open("rb") as file:
        list(make_reader(file, validate_crcs=True).iter_messages())
    with AnyReader([path.parent]) as bag:
        for connection, _, raw in bag.messages():
            bag.deserialize(raw, connection.msgtype)


def test_a_sound_log_stays_what_it_is(whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "bag" / "again.mcap"
    recover_command(whole, out=out)
    assert "nothing missing" in capsys.readouterr().out
    assert messages(out) == messages(whole)
    before, after = read_log(whole), read_log(out)
    assert after.attachments == before.attachments
    assert after.epoch_ns == before.epoch_ns == EPOCH
    assert before.recovered is None and after.recovered == "nothing missing before the end"
    opens_everywhere(out)
    with raises(EldirError, "file.exists"):
        recover_log(whole, out)


def test_cut_anywhere_only_the_end_is_missing(whole: Path, tmp_path: Path) -> None:
    data, original = whole.read_bytes(), messages(whole)
    rng = np.random.default_rng(2)
    cut = tmp_path / "cut.mcap"
    for number, size in enumerate(rng.integers(2500, len(data), 12).tolist()):
        cut.write_bytes(data[:size])
        out = tmp_path / str(number) / "log.mcap"
        found = recover_log(cut, out)
        kept = messages(out)
        assert kept <= original
        assert found.missing == 0 and found.unchecked <= 60 and "design.json" in found.attachments
        # What is earlier than the end of the last whole chunk is there.
        written = [log_time for _, end, log_time in _chunks(data) if end <= size]
        assert {m for m in original if m[1] < max(written, default=0)} <= kept
    opens_everywhere(out)


def _chunks(data: bytes | bytearray) -> list[tuple[int, int, int]]:
    """Start and end of each chunk in the file, and the time of its last message."""
    at, found = 8, []
    while at < len(data) - 8:
        kind, (length,) = data[at], struct.unpack_from("<Q", data, at + 1)
        if kind == Opcode.CHUNK:
            found.append((at, at + 9 + length, struct.unpack_from("<Q", data, at + 17)[0]))
        at += 9 + length
    return found


def test_a_chunk_that_was_cut_gives_what_lies_before_the_cut(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    with Recorder(tmp_path / "a.mcap") as log:
        for i in range(12):
            log.on_frame(0.01 * i, rng.integers(0, 255, (240, 320, 3), np.uint8))
    data = (tmp_path / "a.mcap").read_bytes()
    start, end, _ = max(_chunks(data), key=lambda c: c[1] - c[0])
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: end - (end - start) // 3])
    found = recover_log(cut, tmp_path / "out" / "a.mcap")
    assert 0 < found.unchecked < found.messages < 13 and "could not be checked" in found.losses
    assert messages(tmp_path / "out" / "a.mcap") < messages(tmp_path / "a.mcap")


def test_flipped_bytes_cost_their_chunk_and_invent_nothing(whole: Path, tmp_path: Path) -> None:
    data, original = whole.read_bytes(), messages(whole)
    rng = np.random.default_rng(3)
    damaged = tmp_path / "damaged.mcap"
    for number in range(15):
        bad = bytearray(data)
        for place in rng.integers(0, len(data), 1 + number % 3):
            bad[place] ^= 1 << int(rng.integers(8))
        damaged.write_bytes(bad)
        out = tmp_path / str(number) / "log.mcap"
        found = recover_log(damaged, out)
        kept = messages(out)
        assert kept <= original
        assert len(kept) > len(original) - 3 * 60  # of a chunk of half a second, as many as three
        assert found.missing <= len(original) - len(kept)
        for name, content in read_log(out).attachments.items():
            assert content == read_log(whole).attachments[name]
    opens_everywhere(out)


def test_without_its_first_chunk_a_log_still_knows_its_channels(whole: Path, tmp_path: Path) -> None:
    """The chunk that tells topics and types is gone, and the summary with the end."""
    data = whole.read_bytes()
    _, first, _ = _chunks(data)[0]
    bad = bytearray(data[: len(data) * 3 // 4])
    bad[first - 20] ^= 0xFF
    (tmp_path / "bad.mcap").write_bytes(bad)
    out = tmp_path / "out" / "log.mcap"
    found = recover_log(tmp_path / "bad.mcap", out)
    assert found.broken == ["chunk"] and "1 damaged chunk" in found.losses
    log = read_log(out)
    assert log.tracks is not None and log.tracks.names == NAMES and log.channels == ("front",)
    assert messages(out) < messages(whole)
    assert log.recovered == found.losses
    opens_everywhere(out)


def test_a_chunk_whose_length_is_wrong_does_not_take_the_rest_along(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    start, _, _ = _chunks(data)[3]
    data[start + 4] ^= 0x40
    (tmp_path / "bad.mcap").write_bytes(data)
    recover_log(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    assert messages(tmp_path / "out.mcap") == messages(whole)


def test_a_damaged_attachment_is_left_out_and_named(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    bad = data.replace(b"eldir-design/1", b"eldir-design/2")
    (tmp_path / "bad.mcap").write_bytes(bad)
    found = recover_log(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    assert found.attachments == ("rig.yaml",)
    assert "design.json damaged" in found.losses


def test_what_cannot_be_recovered_is_named(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "text.mcap").write_text("no log at all " * 100)
    for name, code in (
        ("none.mcap", "file.missing"),
        ("empty.mcap", "file.empty"),
        ("text.mcap", "log.nothing-to-recover"),
        (".", "bag.no-metadata"),
    ):
        with raises(InputError, code):
            recover_log(tmp_path / name, tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


def test_killed_at_any_instant_at_most_a_second_is_lost(tmp_path: Path) -> None:
    kill_and_recover(tmp_path / "killed", [0.55, 1.3, 1.7])


def test_a_log_and_its_description_are_a_bag(whole: Path) -> None:
    with AnyReader([whole.parent]) as reader:
        assert reader.message_count == read_log(whole).frame_count * 4 + 2 * 24 + 1
        qos = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}  # type: ignore[union-attr]
        assert qos["/camera/camera_info"].durability.name == "TRANSIENT_LOCAL"
        assert qos["/marks"].reliability.name == "RELIABLE"
        assert reader.start_time == EPOCH and reader.duration == 11_900_000_001
    assert read_log(whole.parent).frame_count == 120
    assert find_log(whole.parent) == whole


def test_a_second_log_beside_leaves_the_bag_alone(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", 0.5)
    before = (tmp_path / "metadata.yaml").read_text()
    record(tmp_path / "b.mcap", 0.5)
    assert (tmp_path / "metadata.yaml").read_text() == before
    with AnyReader([tmp_path / "b.mcap"]) as reader:
        assert reader.message_count > 0
    for damaged in (
        "what: ever",
        *(f"rosbag2_bagfile_information: {{relative_file_paths: {v}}}" for v in "5a"),
    ):
        (tmp_path / "metadata.yaml").write_text(f"{damaged}\n")
        with raises(InputError, "file.damaged", match=r"metadata\.yaml"):
            read_log(tmp_path)


def test_the_foxglove_layout_shows_topics_that_a_log_has(tmp_path: Path) -> None:
    """Every topic and field that its panels name, in a log of the rig that `eldir rig new` writes."""
    from eldir.core.records import FloatArray
    from eldir_hardware.rig.configuration import Rig
    from tests.hardware.rigs_and_schedules import rig_text

    (tmp_path / "rig.yaml").write_text(rig_text(1, "design.json"))
    rig = Rig.load(tmp_path / "rig.yaml")
    springs = [f"spring{c.spring}_{c.face}" for c in rig.channels]
    contacts = [f"channel{c.channel}" for c in rig.channels]
    places: FloatArray = np.zeros((5, 2))
    with Recorder(tmp_path / "a.mcap", contacts, springs) as log:
        log.on_frame(0.0, picture(1))
        log.on_tracks(0.0, [f"m{i}" for i in range(1, 6)], places)
        log.on_relays(0.0, [True] * len(contacts))
        log.on_temperatures(0.0, [20.0] * len(springs))
        log.on_status(0.0, "player", "played")
    with AnyReader([tmp_path]) as reader:
        topics = {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}
    layout = json.loads((ROOT / "docs" / "foxglove-layout.json").read_text())
    named, fields = set(), []
    for panel in layout["configById"].values():
        named |= set(panel.get("topics", {})) | set(panel.get("imageMode", {}).values())
        named |= {panel["topicToRender"]} if "topicToRender" in panel else set()
        fields += [path["value"] for path in panel.get("paths", [])]
    for path in fields:
        topic, *parts = path.split(".")
        value = topics[topic]
        for part in parts:
            name, _, index = part.rstrip("]").partition("[")
            value = getattr(value, name)
            value = value[int(index)] if index else value
        assert isinstance(value, float), path
        named.add(topic)
    assert named <= set(topics)
    assert len(named) > 12
    assert set(_leaves(layout["layout"])) == set(layout["configById"])


def _leaves(node: object) -> list[str]:
    return [*_leaves(node["first"]), *_leaves(node["second"])] if isinstance(node, dict) else [str(node)]


def test_the_disk_has_it_while_a_program_lives(tmp_path: Path) -> None:
    """Nothing more is recorded after the first second: what was is on the disk all the same."""
    from eldir_hardware.log.background import BackgroundRecorder

    synced: list[int] = []
    real, os.fdatasync = os.fdatasync, lambda fd: synced.append(os.fstat(fd).st_size)
    try:
        with BackgroundRecorder(Recorder(tmp_path / "a.mcap", epoch_ns=EPOCH), sync=0.05) as log:
            log.on_tracks(0.0, NAMES, POSITIONS)
            deadline = time.monotonic() + 5
            while not any(size > 1000 for size in synced) and time.monotonic() < deadline:
                time.sleep(0.01)
            size = (tmp_path / "a.mcap").stat().st_size
            assert max(synced) == size > 1000
    finally:
        os.fdatasync = real


def test_what_a_log_says_of_its_run_is_kept(tmp_path: Path) -> None:
    facts = {"rig_sha256": "1a", "schedule_sha256": "2b", "design_sha256": "3c", "accepted": "the reason"}
    with Recorder(tmp_path / "log.mcap", epoch_ns=EPOCH, facts=facts) as log:
        for i in range(300):
            log.on_tracks(0.1 * i, NAMES, POSITIONS)
    data = (tmp_path / "log.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    recover_log(tmp_path / "cut.mcap", tmp_path / "1" / "log.mcap")
    recover_log(tmp_path / "1" / "log.mcap", tmp_path / "2" / "log.mcap")
    for number in "12":
        note = read_contents(tmp_path / number / "log.mcap").metadata
        assert note.items() >= facts.items()
        assert note["recovered"] == "nothing missing before the end" and note["epoch_ns"] == str(EPOCH)
    assert read_facts(tmp_path / "1" / "log.mcap").design == "3c"

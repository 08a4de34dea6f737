"""Logs: read back by us, by rosbags and by the mcap reader; killed, cut and damaged."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from eldir.errors import EldirError, InputError
from eldir_hardware.log.reader import _tracks, read_log
from eldir_hardware.log.recorder import Recorder
from tests.hardware.log.log_contents import EPOCH, NAMES, POSITIONS, picture
from tests.raised import raises


def record(path: Path, frames: int = 12) -> Path:
    with Recorder(path, channels=("front", "rear"), springs=("s4", "s9"), epoch_ns=EPOCH) as log:
        log.attach("design.json", b'{"format": "eldir-design/1"}')
        for i in range(frames):
            t = 0.1 * i
            log.on_frame(t, picture(i))
            log.on_tracks(t, NAMES, POSITIONS + np.array([0.01 * i, 0]))
            if i % 5 == 0:
                log.on_relays(t, (True, i > 5))
                log.on_temperatures(t, (20.0 + i, 30.0))
        log.on_status(1.2, "player", "played to the end", {"cycles": 5})
    return path


def test_a_log_comes_back(tmp_path: Path) -> None:
    log = read_log(record(tmp_path / "a.mcap"))
    assert log.epoch_ns == EPOCH
    assert log.attachments == {"design.json": b'{"format": "eldir-design/1"}'}
    assert log.tracks is not None and log.tracks.names == NAMES
    np.testing.assert_allclose(log.tracks.times, 0.1 * np.arange(12), atol=1e-9)
    expected = np.array([POSITIONS + np.array([0.01 * i, 0]) for i in range(12)])
    np.testing.assert_array_equal(log.tracks.positions, expected)
    assert log.channels == ("front", "rear")
    np.testing.assert_allclose(log.relay_times, [0, 0.5, 1.0])
    assert log.relays.tolist() == [[True, False], [True, False], [True, True]]
    assert log.springs == ("s4", "s9")
    np.testing.assert_array_equal(log.temperatures, [[20, 30], [25, 30], [30, 30]])
    np.testing.assert_allclose(log.temperature_times, [0, 0.5, 1.0])
    assert log.statuses == ((pytest.approx(1.2), "player", "played to the end"),)
    frames = list(log.frames)
    assert log.frame_count == len(frames) == 12
    for i, (t, image) in enumerate(frames):
        assert t == pytest.approx(0.1 * i)
        assert np.abs(image.astype(int) - picture(i)).mean() < 3


def test_an_event_before_the_beginning_does_not_move_the_start(tmp_path: Path) -> None:
    start = time.time_ns() + 1_500_000_000
    with Recorder(tmp_path / "a.mcap", ("front",), ("s4",), epoch_ns=None) as recorder:
        recorder.on_status(0.0, "virtual rig", "moved by eldir")
        recorder.begin_at(start)
        recorder.on_relays(0.25, (True,))
    log = read_log(tmp_path / "a.mcap")
    assert log.epoch_ns == start
    np.testing.assert_allclose(log.relay_times, [0.25])
    assert [t for t, _, _ in log.statuses] == [pytest.approx(-1.5, abs=1.0)]


def test_a_log_that_never_began_is_readable(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", epoch_ns=None) as recorder:
        recorder.on_status(0.0, "virtual rig", "moved by eldir")
        recorder.on_status(0.0, "player", "the board does not arm", good=False)
    log = read_log(tmp_path / "a.mcap")
    assert [text for _, _, text in log.statuses] == ["moved by eldir", "the board does not arm"]
    assert log.statuses[-1][0] == 0.0


def test_a_log_without_camera_or_rig_comes_back(tmp_path: Path) -> None:
    with Recorder(tmp_path / "bare.mcap") as recorder:
        recorder.attach("schedule.json", b"{}")
    log = read_log(tmp_path / "bare.mcap")
    assert log.tracks is None and log.frame_count == 0
    assert log.relays.shape == (0, 0) and log.temperatures.shape == (0, 0)
    with Recorder(tmp_path / "unnamed.mcap") as recorder:
        recorder.on_relays(0.0, (True,))
        recorder.on_tracks(0.0, NAMES, np.full((3, 2), np.nan))
    log = read_log(tmp_path / "unnamed.mcap")
    assert log.channels == ("contact0",)
    assert log.tracks is not None and np.isnan(log.tracks.positions).all()


def test_rosbags_reads_it(tmp_path: Path) -> None:
    with AnyReader([record(tmp_path / "a.mcap")]) as reader:
        kinds = {c.topic: (c.msgtype, c.msgcount) for c in reader.connections}
        assert kinds == {
            "/camera/camera_info": ("sensor_msgs/msg/CameraInfo", 1),
            "/camera/image_raw/compressed": ("sensor_msgs/msg/CompressedImage", 12),
            "/marks": ("visualization_msgs/msg/MarkerArray", 12),
            "/marks/m1": ("geometry_msgs/msg/PointStamped", 12),
            "/marks/m2": ("geometry_msgs/msg/PointStamped", 12),
            "/relays": ("control_msgs/msg/DynamicJointState", 3),
            "/springs/s4/temperature": ("sensor_msgs/msg/Temperature", 3),
            "/springs/s9/temperature": ("sensor_msgs/msg/Temperature", 3),
            "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", 1),
        }
        seen = [(c.topic, t, reader.deserialize(raw, c.msgtype)) for c, t, raw in reader.messages()]
    points = [(t, m) for topic, t, m in seen if topic == "/marks/m2"]
    assert points[3][0] == EPOCH + 300_000_000
    stamp, point = points[3][1].header.stamp, points[3][1].point
    assert stamp.sec * 10**9 + stamp.nanosec == points[3][0]
    assert (point.x, point.y, point.z) == (pytest.approx(0.15), 0.0, pytest.approx(0.06))
    info = next(m for topic, _, m in seen if topic == "/camera/camera_info")
    assert (info.width, info.height) == (64, 48)


def test_the_mcap_reader_finds_what_ros_asks_for(tmp_path: Path) -> None:
    with record(tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
        for schema in summary.schemas.values():
            parts = schema.data.decode().split("=" * 80 + "\n")
            assert all(p.startswith("MSG: ") for p in parts[1:])
        for channel in summary.channels.values():
            assert channel.message_encoding == "cdr"
            (profile,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
            assert profile["reliability"] == 1  # a number, which every distribution reads
            assert set(profile) >= {"history", "depth", "durability", "deadline", "lifespan", "liveliness"}
        assert [a.name for a in reader.iter_attachments()] == ["design.json"]
        assert sum(1 for _ in reader.iter_messages()) == summary.statistics.message_count  # type: ignore[union-attr]


def test_the_same_run_gives_the_same_bytes(tmp_path: Path) -> None:
    assert record(tmp_path / "a.mcap").read_bytes() == record(tmp_path / "b.mcap").read_bytes()


_KILLED = """
import sys, time
import numpy as np
from eldir_hardware.log.recorder import Recorder
with Recorder(sys.argv[1], epoch_ns=int(sys.argv[2])) as log:
    start = time.monotonic()
    while True:
        t = time.monotonic() - start
        log.on_tracks(t, ("m1",), np.array([[t, 0.0]]))
        log.on_frame(t, np.zeros((48, 64, 3), np.uint8))
        print(t, flush=True)
        time.sleep(0.02)
"""


def test_a_killed_run_loses_less_than_a_second(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    child = subprocess.Popen(
        [sys.executable, "-c", _KILLED, path, str(EPOCH)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    times = []
    for line in child.stdout:
        times.append(float(line))
        if times[-1] > 1.3:
            break
    child.send_signal(signal.SIGKILL)
    times += [float(line) for line in child.communicate()[0].splitlines()]
    with path.open("rb") as file:
        stamps = []
        try:
            for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                if channel.topic == "/marks/m1":
                    stamps.append((message.log_time - EPOCH) * 1e-9)
        except Exception:  # the end is missing, as it must be
            pass
    np.testing.assert_allclose(stamps, times[: len(stamps)], atol=1e-8)  # none is missing in between
    assert times[-1] - stamps[-1] < 1.0
    with raises(InputError, "log.not-whole", match=r"killed\.mcap"):
        read_log(path)


def test_a_run_that_fails_leaves_a_sound_log(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), Recorder(tmp_path / "a.mcap") as log:
        log.on_relays(0.0, (True, False))
        raise RuntimeError("the cable came off")
    assert read_log(tmp_path / "a.mcap").relays.tolist() == [[True, False]]
    with raises(EldirError, "log.not-open"):
        log.on_relays(1.0, (True, False))


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap")
    before = path.read_bytes()
    with raises(EldirError, "file.exists"), Recorder(path):
        pass
    assert path.read_bytes() == before
    (tmp_path / "file").write_text("")
    with raises(EldirError, "file.not-written"), Recorder(tmp_path / "file" / "a.mcap"):
        pass


_FULL = """
import resource, sys
import numpy as np
from eldir.errors import EldirError
from eldir_hardware.log.recorder import Recorder
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
noise = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)
try:
    with Recorder(sys.argv[1]) as log:
        for i in range(100):
            log.on_frame(0.1 * i, noise)
except EldirError as error:
    print(error)
"""


def test_a_full_disk_is_told_in_one_line(tmp_path: Path) -> None:
    call = [sys.executable, "-c", _FULL, str(tmp_path / "full.mcap")]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout.startswith(f"cannot write {tmp_path / 'full.mcap'}: File too large")


def test_what_happens_before_the_start_has_a_time(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap") as log:
        log.on_relays(-1.5, (False,))
        log.on_relays(0.0, (True,))
    np.testing.assert_allclose(read_log(tmp_path / "a.mcap").relay_times, [-1.5, 0])


def test_bad_logs_are_named(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "text.mcap").write_text("no log at all, but long enough to be looked at for a while\n" * 5)
    (tmp_path / "short.mcap").write_bytes(b"\x89MCAP0\r\n")
    with (tmp_path / "foreign.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="someone else")
        writer.finish()
    for name, code, found in (
        ("none.mcap", "file.missing", None),
        ("empty.mcap", "file.empty", None),
        ("short.mcap", "log.not-whole", None),
        ("text.mcap", "log.not-whole", None),
        ("foreign.mcap", "log.other-file", "someone else"),
        (".", "bag.no-metadata", None),
    ):
        with raises(InputError, code, match=found):
            read_log(tmp_path / name)


def test_damage_is_named_or_harmless(tmp_path: Path) -> None:
    """Cut anywhere, a log is refused; with a byte flipped, it is refused or reads the same."""
    whole = record(tmp_path / "a.mcap").read_bytes()
    good = read_log(tmp_path / "a.mcap")
    rng = np.random.default_rng(3)
    path = tmp_path / "bad.mcap"
    for cut in rng.integers(1, len(whole), 30):
        path.write_bytes(whole[:cut])
        with pytest.raises(InputError, match=r"bad\.mcap"):
            read_log(path)
    refused = 0
    for place in rng.integers(0, len(whole), 150):
        data = bytearray(whole)
        data[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        try:
            log = read_log(path)
            for (_, image), (_, expected) in zip(log.frames, good.frames, strict=True):
                assert np.array_equal(image, expected)
            assert log.tracks == good.tracks
            np.testing.assert_array_equal(log.temperatures, good.temperatures)
        except InputError as error:
            assert "bad.mcap" in str(error)
            refused += 1
    assert refused > 100


def test_marks_out_of_the_order_of_time_are_damage() -> None:
    """No recorder writes them."""
    arrays = [
        SimpleNamespace(markers=[SimpleNamespace(ns="m1", header=SimpleNamespace(stamp=stamp))])
        for stamp in (SimpleNamespace(sec=2, nanosec=0), SimpleNamespace(sec=1, nanosec=0))
    ]
    with raises(InputError, "file.damaged", match=r"a\.mcap .*order of time"):
        _tracks(Path("a.mcap"), arrays, 0)

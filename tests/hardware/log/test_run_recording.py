"""A log from stamped messages: what belongs to the run, and when it is closed."""

import numpy as np
import pytest

from eldir.errors import EldirError, InputError
from eldir_hardware.images import jpeg
from eldir_hardware.log import background
from eldir_hardware.log.background import CLOSING_DELAY, RunRecording
from eldir_hardware.log.reader import read_log, read_room
from eldir_hardware.log.recorder import Recorder
from tests.hardware.log.log_contents import EPOCH, NAMES, POSITIONS, picture
from tests.raised import raises

CHANNELS, SPRINGS = ("channel1", "channel2"), ("spring0_front", "spring0_back")


def at(t: float) -> int:
    return EPOCH + round(1e9 * t)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run" / "log.mcap"


def test_it_has_the_bytes_of_the_librarys_log(path, tmp_path, monkeypatch):
    monkeypatch.setattr(background, "_FLUSH_INTERVAL", 60.0)  # else chunks end where the clock says
    with Recorder(tmp_path / "direct.mcap", CHANNELS, SPRINGS, EPOCH) as log:
        log.attach("schedule.json", b"{}")
        log.attach("rig.yaml", b"x: 1")
        for t in (0.0, 0.25):
            log.on_relays(t, (True, False))
            log.on_temperatures(t, (30.0, 22.0))
            log.on_currents(t, (3.25, 0.0), (3.0, 0.0))
            log.on_frame(t, picture(1))
            log.on_tracks(t, NAMES, POSITIONS)
        log.on_status(0.5, "player", "played to the end")
    recording = RunRecording(path, CHANNELS, SPRINGS, EPOCH)
    recording.attach({"schedule.json": b"{}", "rig.yaml": b"x: 1"})
    for t in (0.0, 0.25):
        recording.on_board(at(t), (True, False), (30.0, 22.0), (3.25, 0.0), (3.0, 0.0))
        recording.on_picture(at(t), jpeg.encode(picture(1)))
        recording.on_tracks(at(t), NAMES, POSITIONS)
    recording.end(at(0.5), 100.0, "played to the end", True)
    recording.close(at(9.0), "")
    assert path.read_bytes() == (tmp_path / "direct.mcap").read_bytes()


def test_what_was_measured_of_the_air_is_kept_as_by_rig_drive(path):
    RunRecording(path, CHANNELS, SPRINGS, EPOCH, room_c=21.4375).close(at(1.0), "over")
    log = read_log(path)
    assert log.room_c == 21.4375
    assert log.statuses[0] == (0.0, "room", "the air was measured before the run: 21.4375 C")


@pytest.mark.parametrize("text", ["warm", "nan", "inf", ""])
def test_a_room_that_is_no_temperature_is_a_damaged_log(path, text):
    assert read_room(path, {}) is None and read_room(path, {"room_c": "21.5"}) == 21.5
    with raises(InputError, "file.damaged", match="a temperature of the room"):
        read_room(path, {"room_c": text})


def test_only_what_belongs_to_the_run_is_written(path):
    recording = RunRecording(path, CHANNELS, SPRINGS, EPOCH)
    recording.on_board(at(-0.5), (False, False), (22.0, 22.0))
    recording.on_picture(at(-0.1), jpeg.encode(picture(1)))
    recording.on_tracks(at(-0.1), NAMES, POSITIONS)
    for t in (0.1, 0.9):
        recording.on_picture(at(t), jpeg.encode(picture(1)))
        recording.on_tracks(at(t), NAMES, POSITIONS)
    recording.end(at(1.0), 100.0, "cancelled", False)
    recording.on_tracks(at(1.0), NAMES, POSITIONS)
    recording.on_tracks(at(1.1), NAMES, POSITIONS)
    recording.on_board(at(1.1), (False, False), (22.0, 22.0))
    assert not recording.is_due(100.0 + CLOSING_DELAY) and recording.is_due(100.1 + CLOSING_DELAY)
    recording.close(at(5.0), "not this")
    log = read_log(path)
    assert log.tracks is not None and log.frame_count == 2
    np.testing.assert_allclose(log.tracks.times, [0.1, 0.9, 1.0], atol=1e-9)
    np.testing.assert_allclose(log.relay_times, [-0.5], atol=1e-9)
    assert log.statuses[-1][1:] == ("player", "cancelled")


def test_without_a_message_of_the_end_the_reason_is_written(path):
    recording = RunRecording(path, CHANNELS, SPRINGS, EPOCH)
    recording.on_fault(at(0.5), "camera", "sends no heartbeats")
    assert not recording.is_due(1e9)
    recording.close(at(2.0), "the recorder was shut down")
    log = read_log(path)
    assert [s[1:] for s in log.statuses] == [
        ("camera", "sends no heartbeats"),
        ("player", "the recorder was shut down"),
    ]
    assert log.statuses[-1][0] == pytest.approx(2.0)


def test_a_log_that_exists_is_not_written_over(path):
    RunRecording(path, CHANNELS, SPRINGS, EPOCH).close(at(0.1), "")
    with raises(EldirError, "file.exists"):
        RunRecording(path, CHANNELS, SPRINGS, EPOCH)

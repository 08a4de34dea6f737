"""A run starts when everything is ready, and its log attests what was loaded."""

from __future__ import annotations

import hashlib
import time
from contextlib import contextmanager
from dataclasses import replace

import pytest
import yaml

from eldir_hardware.clock import WallClock
from eldir_hardware.guardian._connection import GuardianConnection
from eldir_hardware.guardian.bank import LEAD
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_emulator
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.schedule import Event
from tests.hardware.emulated_rigs import rig_file
from tests.hardware.rigs_and_schedules import RIG, SCHEDULE, rig_text, rig_with

SHORT = with_digests(
    replace(
        SCHEDULE,
        period_s=4.0,
        events=(Event(0.0, 0, "front", 1, True), Event(0.5, 0, "front", 1, False)),
        cycles=1,
        conditioning_cycles=0,
        settle_s=0.0,
    ),
    rig_with(limits={"min_off_s": 1.0}),
)


@pytest.fixture
def emulated():
    board = get_emulator("lcus")(4, WallClock())
    board.start()
    yield board
    board.close()


def test_a_slow_board_and_a_loaded_disk_delay_the_start_and_stop_nothing(emulated, tmp_path, monkeypatch):
    """Answers 0.15 s late make the arming longer than 1.5 s; the log's first files take another second."""
    attach = Recorder.attach

    def slowly(self, name, file):
        time.sleep(0.4)
        attach(self, name, file)

    monkeypatch.setattr(Recorder, "attach", slowly)
    path = rig_file(tmp_path / "rig.yaml", "lcus", emulated.port, limits={"min_off_s": 1.0})
    emulated.faults.late = 0.15
    begun = time.monotonic()
    armed = []

    @contextmanager
    def steer(player):
        arm = player._bank.arm

        def slow_arm():
            time.sleep(2.0)  # as a board that needs many attempts
            arm()
            emulated.faults.late = 0.0
            armed.append(time.monotonic())

        player._bank.arm = slow_arm
        yield

    played = drive_rig(SHORT, Rig.load(path), path, tmp_path / "log.mcap", DriveConfig(control=steer))
    log = read_log(tmp_path / "log.mcap")
    assert "played to the end" in str(log.statuses)
    closed, opened = emulated.contact_events[:2]
    assert armed[0] - begun > 1.5, "the start that was planned had passed"
    # Times in the log count from the true start: the contact that closes at 0 s is seen closed soon after.
    seen = [t for t, row in zip(log.relay_times, log.relays, strict=True) if row[0]]
    assert -0.05 < seen[0] < 1.5 and seen[-1] < 2.5
    assert closed.t - armed[0] > LEAD - 0.05 and played.max_delay_s < 0.5
    start = 1e-9 * log.epoch_ns + time.monotonic() - time.time()
    assert closed.t == pytest.approx(start, abs=0.5), "time of day at the start"
    assert opened.t - closed.t == pytest.approx(0.5, abs=0.3)


def test_a_board_that_does_not_arm_leaves_a_readable_log(emulated, tmp_path):
    path = rig_file(tmp_path / "rig.yaml", "lcus", emulated.port, limits={"min_off_s": 1.0})
    emulated.faults.deaf.add(1)
    emulated.coils[0] = emulated._contacts[0] = True
    with pytest.raises(Exception, match="not proven"):
        drive_rig(SHORT, Rig.load(path), path, tmp_path / "log.mcap")
    log = read_log(tmp_path / "log.mcap")
    assert "not proven" in str(log.statuses) and abs(1e-9 * log.epoch_ns - time.time()) < 60


@pytest.mark.parametrize("moment", ["before", "steer", "first report", "last report"])
def test_the_log_attests_the_rig_that_was_loaded(moment, tmp_path):
    """The file is replaced by another rig at any moment after loading."""
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text().replace("camera:", "# camera:"))
    other = rig_text(seed=9).replace("max_temperature_c: 90", "max_temperature_c: 80").encode()
    rig = Rig.load(path)
    times = []

    def replaced(now):
        if moment == now:
            path.write_bytes(other)

    @contextmanager
    def steer(player):
        replaced("steer")
        yield

    def progress(t):
        if not times:
            replaced("first report")
        times.append(t)
        if t > 100:
            replaced("last report")

    replaced("before")
    drive_rig(SCHEDULE, rig, path, tmp_path / "log.mcap", DriveConfig(on_time=progress, control=steer))
    assert path.read_bytes() == other
    log = read_log(tmp_path / "log.mcap")
    assert log.attachments["rig.yaml"] == rig.source
    assert Rig.from_json(yaml.safe_load(rig.source)).model_dump() == rig.model_dump()
    assert rig.virtual.seed != 9
    assert hashlib.sha256(rig.source).hexdigest() == rig.digest
    assert rig.digest in str(log.statuses), "its digest is in the log"


def test_the_guardian_gets_the_values_that_are_logged(emulated, tmp_path, monkeypatch):
    """The file is gone before the guardian starts: nothing but the loaded values can reach it."""
    sent = []
    send = GuardianConnection.send
    monkeypatch.setattr(
        GuardianConnection, "send", lambda self, **message: (sent.append(message), send(self, **message))
    )
    path = rig_file(tmp_path / "rig.yaml", "lcus", emulated.port, limits={"min_off_s": 1.0})
    rig = Rig.load(path)
    path.unlink()
    drive_rig(SHORT, rig, path, tmp_path / "log.mcap")
    log = read_log(tmp_path / "log.mcap")
    assert log.attachments["rig.yaml"] == rig.source
    logged = tmp_path / "logged.yaml"
    logged.write_bytes(log.attachments["rig.yaml"])
    assert sent[0]["rig"] == Rig.load(logged).to_json()


def test_a_rig_that_comes_from_no_file_attests_its_values(tmp_path):
    copy = tmp_path / "rig.yaml"
    copy.write_bytes(RIG.source)
    assert Rig.load(copy).model_dump() == RIG.model_dump()

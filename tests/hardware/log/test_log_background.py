"""The recorder that keeps nobody waiting: order, back-pressure, failure."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from eldir.errors import EldirError
from eldir_hardware.log import background
from eldir_hardware.log.background import MAX_PICTURES, BackgroundRecorder
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from tests.hardware.log.log_contents import EPOCH, NAMES, POSITIONS, picture


class Stuck(Recorder):
    """A disk that does not take a picture until it is told to."""

    def __init__(self, path: Path):
        super().__init__(path, epoch_ns=EPOCH)
        self.taken, self.free = threading.Event(), threading.Event()

    def on_frame(self, t: float, bgr: np.ndarray) -> None:
        self.taken.set()
        self.free.wait(100)
        super().on_frame(t, bgr)


def test_a_log_is_the_same_as_without(tmp_path: Path) -> None:
    for name in ("direct", "background"):
        (tmp_path / name).mkdir()
        plain = Recorder(tmp_path / name / "a.mcap", channels=("front",), springs=("s",), epoch_ns=EPOCH)
        with BackgroundRecorder(plain) if name == "background" else plain as log:
            log.attach("design.json", b"{}")
            for i in range(20):
                positions = POSITIONS + 0.01 * i
                log.on_frame(0.1 * i, picture(i % 10))
                log.on_tracks(0.1 * i, NAMES, positions)
                positions[:] = 7  # is the caller's again
                log.on_relays(0.1 * i, (i % 2 == 0,))
                log.on_temperatures(0.1 * i, (20.0 + i,))
            log.on_status(2.0, "player", "played to the end")
    a, b = (read_log(tmp_path / name / "a.mcap") for name in ("direct", "background"))
    assert a.tracks == b.tracks and a.attachments == b.attachments and a.statuses == b.statuses
    np.testing.assert_array_equal(a.relays, b.relays)
    np.testing.assert_array_equal(a.temperatures, b.temperatures)
    for (t, x), (u, y) in zip(a.frames, b.frames, strict=True):
        assert t == u and np.array_equal(x, y)


def test_pictures_are_left_out_before_tracks_and_counted(tmp_path: Path) -> None:
    stuck = Stuck(tmp_path / "a.mcap")
    with BackgroundRecorder(stuck) as log:
        log.on_frame(0.0, picture(0))
        assert stuck.taken.wait(60)  # it is being written now, so to say
        for i in range(1, 2 * MAX_PICTURES + 1):
            log.on_frame(0.1 * i, picture(0))
            log.on_tracks(0.1 * i, NAMES, POSITIONS)
        assert not stuck.free.is_set(), "nobody waited for the disk"
        stuck.free.set()
        assert log.dropped_pictures == MAX_PICTURES and log.dropped_others == 0
    found = read_log(tmp_path / "a.mcap")
    assert found.frame_count == 1 + MAX_PICTURES
    assert found.tracks is not None and len(found.tracks.times) == 2 * MAX_PICTURES
    assert [(name, text) for _, name, text in found.statuses] == [("log", "too slow")]


def test_other_messages_are_bounded_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(background, "MAX_MESSAGES", 50)
    stuck = Stuck(tmp_path / "a.mcap")
    with BackgroundRecorder(stuck) as log:
        log.on_frame(0.0, picture(0))
        time.sleep(0.1)
        for i in range(80):
            log.on_tracks(0.1 * i, NAMES, POSITIONS)
        stuck.free.set()
        assert log.dropped_others == 30


def test_a_failure_is_told_to_whoever_records_next_and_at_the_end(tmp_path: Path) -> None:
    class Full(Recorder):
        def on_tracks(self, t: float, names: object, positions: object) -> None:
            raise EldirError("cannot write a.mcap: No space left on device")

    with pytest.raises(EldirError, match="No space"), BackgroundRecorder(Full(tmp_path / "a.mcap")) as log:
        log.on_tracks(0.0, NAMES, POSITIONS)
        for i in range(500):
            log.on_relays(0.1 * i, (True,))
            time.sleep(0.01)
    assert read_log(tmp_path / "a.mcap").tracks is None
    with pytest.raises(EldirError, match="No space"), BackgroundRecorder(Full(tmp_path / "b.mcap")) as log:
        log.on_tracks(0.0, NAMES, POSITIONS)
    with pytest.raises(RuntimeError), BackgroundRecorder(Full(tmp_path / "c.mcap")) as log:
        log.on_tracks(0.0, NAMES, POSITIONS)
        raise RuntimeError("what went wrong first is told")

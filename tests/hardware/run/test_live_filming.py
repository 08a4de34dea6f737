"""A real rig that is filmed while it heats: pictures over HTTP, an emulated board on a pseudo-terminal."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from eldir.errors import EldirError, InputError
from eldir_app.doctor import examine
from eldir_hardware.camera.lens import validity_period
from eldir_hardware.clock import WallClock
from eldir_hardware.log.reader import read_log
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_emulator
from eldir_hardware.rig.template import real_rig
from eldir_hardware.run.drive import drive_rig, to_dry_run
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.schedule import ActuationSchedule, Event
from eldir_hardware.vision.pipeline import track_frames
from eldir_hardware.vision.recording_setup import find_recorded_plane
from eldir_hardware.vision.sources import LoggedFrames
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.vision.walking_films import MARKED, NAMES, SPACE, film, rms_mm, walk
from tests.raised import raises

RATE = 10.0  # pictures a second
SCHEDULE = ActuationSchedule(
    1.6,
    events=(Event(0.0, 0, "front", 1, True), Event(0.2, 0, "front", 1, False)),
    cycles=2,
    conditioning_cycles=0,
    settle_s=0.3,
    springs=(7,),
)


@pytest.fixture(scope="module")
def pictures() -> tuple[list[bytes], VirtualCamera]:
    camera = VirtualCamera(7, SPACE)
    frames = film(camera, np.arange(0, 10, 1 / RATE))
    quality = [cv2.IMWRITE_JPEG_QUALITY, 95]
    return [cv2.imencode(".jpg", image, quality)[1].tobytes() for _, image in frames], camera


@contextmanager
def streamed(pictures: list[bytes], lasting: float = 60.0) -> Iterator[tuple[str, list[float]]]:
    """An address where a camera's pictures come as they are taken, and when it took the first."""
    begun: list[float] = []

    class Phone(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=next")
            self.end_headers()
            begun.append(time.monotonic())
            for k, data in enumerate(pictures[: round(lasting * RATE)]):
                time.sleep(max(begun[-1] + k / RATE - time.monotonic(), 0))
                head = f"--next\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                try:
                    self.wfile.write(head.encode() + data + b"\r\n")
                except OSError:  # nobody looks any more
                    return

        def log_message(self, *_: object) -> None:
            """Nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Phone)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/video", begun
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture
def port() -> Iterator[str]:
    board = get_emulator("lcus")(4, WallClock())
    yield board.start()
    board.close()


def rig_file(folder: Path, port: str, device: str, camera: VirtualCamera, more: str = "") -> Path:
    (folder / "tags.json").write_text(json.dumps(camera.board.to_json()))
    text = real_rig("lcus", port).replace("current_limit_a: null", "current_limit_a: 1.0")
    text = text.replace("resistance_ohm: null", "resistance_ohm: 0.987")
    text = text.replace("min_off_s: 8.0", "min_off_s: 1.0")
    text += "cutoff: {kind: timer, max_on_s: 6.3}\n"
    path = folder / "rig.yaml"
    path.write_text(f"{text}camera: {{kind: live, device: '{device}', tags: tags.json{more}}}\n")
    return path


def for_rig(path: Path) -> ActuationSchedule:
    return with_digests(SCHEDULE, Rig.load(path))


def test_what_a_camera_sees_is_recorded_while_springs_heat(pictures, port, tmp_path) -> None:
    data, camera = pictures
    with streamed(data) as (address, begun):
        path = rig_file(tmp_path, port, address, camera)
        drive_rig(for_rig(path), Rig.load(path), path, tmp_path / "log.mcap")
    log = read_log(tmp_path / "log.mcap")
    assert log.relays[:, 0].any() and not log.relays[:, 1:].any()
    source = LoggedFrames(log)
    found = track_frames(source, find_recorded_plane(source), NAMES).trajectory
    assert SCHEDULE.duration - 0.3 < found.times[-1] - found.times[0] < SCHEDULE.duration + 1
    assert len(found.times) > 0.9 * RATE * (found.times[-1] - found.times[0])
    # Where the robot was tells when each picture was taken: one time for all of them, that of the log.
    apart = [
        rms_mm(found.positions, np.array([walk(t + late)[MARKED] for t in found.times]))
        for late in np.arange(0, 6, 0.02)
    ]
    assert min(apart) < 1.0
    started = 1e-9 * log.epoch_ns + time.monotonic() - time.time()
    assert 0.02 * int(np.argmin(apart)) + begun[0] == pytest.approx(started, abs=0.1)


def test_a_camera_that_fails_is_told_when_all_is_played(pictures, port, tmp_path) -> None:
    data, camera = pictures
    with streamed(data, lasting=3.5) as (address, _):
        path = rig_file(tmp_path, port, address, camera)
        with pytest.raises(EldirError, match=r"gives no picture any more.*pictures until [0-9.]+ s"):
            drive_rig(for_rig(path), Rig.load(path), path, tmp_path / "log.mcap")
    log = read_log(tmp_path / "log.mcap")
    assert log.relay_times[-1] > SCHEDULE.duration - 1.6  # it went on heating
    assert any("no frame for" in message for *_, message in log.statuses)


def test_nothing_heats_before_a_camera_that_cannot_be_used(pictures, port, tmp_path) -> None:
    data, camera = pictures
    out = tmp_path / "log.mcap"
    with streamed(data) as (address, _):
        path = rig_file(tmp_path, port, address, camera, ", width: 1280, height: 720")
        with raises(InputError, "camera.other-size", match="expected 1280 x 720; found 640 x 480"):
            drive_rig(for_rig(path), Rig.load(path), path, out)
        path = rig_file(tmp_path, port, address, camera)
    with raises(InputError, "camera.no-picture", match="http://127.*check its address"):
        drive_rig(for_rig(path), Rig.load(path), path, out)
    assert not out.exists()
    short = with_digests(replace(SCHEDULE, cycles=1), Rig.load(path))
    drive_rig(short, to_dry_run(Rig.load(path)), path, out)  # a dry run needs no camera


def test_the_doctor_looks_through_the_rigs_camera(pictures, port, tmp_path) -> None:
    data, camera = pictures
    (tmp_path / "plane.json").write_text(json.dumps({"provenance": validity_period(-1.0)}))
    with streamed(data) as (address, _):
        path = rig_file(tmp_path, port, address, camera, ", plane: plane.json")
        findings = examine(Rig.load(path), tmp_path)
    told = {f.subject: f for f in findings}
    assert "frames a second" in told["camera"].text and float(told["camera"].text.split()[0]) > 0.8 * RATE
    assert not told["calibration"].ok and "plane.json" in told["calibration"].text


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ("{kind: live, device: 'camera:0'}", "a plane file or a tag file"),
        ("{kind: live, device: webcam, tags: tags.json}", "camera:0, /dev/video0"),
        ("{kind: virtual}", "a real rig cannot have a virtual camera"),
        ("{kind: other}", "kind"),
    ],
)
def test_a_camera_entry_that_cannot_be(entry: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(real_rig("lcus", "/dev/ttyUSB0") + f"camera: {entry}\n")
    with pytest.raises(InputError, match=says):
        Rig.load(path)

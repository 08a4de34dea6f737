"""What goes wrong while filming is noticed: covered marks, lost and repeated frames, a moved camera."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st

from eldir.errors import InputError
from eldir.trajectory import Trajectory
from eldir_app.commands.calibrate.plane import plane as calibrate_plane_command
from eldir_app.commands.track import track as track_command
from eldir_hardware.camera.lens import require_not_expired, validity_period
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.markers import discs
from eldir_hardware.run.filming import visible_range
from eldir_hardware.schedule import ActuationSchedule, SchedulePrediction
from eldir_hardware.vision.pipeline import track_frames
from eldir_hardware.vision.sources import CameraDevice, open_source, recording_time
from eldir_hardware.vision.tracking_quality import TrackingQuality
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.eldir.random_design import make_design
from tests.hardware.vision.walking_films import (
    BODY,
    MARKED,
    NAMES,
    SPACE,
    SPRINGS,
    TIMES,
    cover,
    film,
    rms_mm,
    truth,
    walk,
    without_tags,
)
from tests.paths import SCHEMAS
from tests.raised import raises

Filmed = tuple[VirtualCamera, list[tuple[float, Image]], Plane]


def test_half_a_second_behind_a_card_is_bridged_and_flagged(filmed: Filmed, tmp_path: Path) -> None:
    camera, frames, plane = filmed
    hidden = []
    for i, (t, whole) in enumerate(frames):
        image = whole.copy()
        for mark, first, last in ((2, 20, 23), (4, 30, 40)):
            if first <= i <= last:
                cover(image, camera, truth()[i, mark])
        hidden.append((t, image))
    found = track_frames(hidden, plane, layout=BODY[MARKED])
    flagged = np.zeros((60, 5), bool)
    flagged[20:24, 2] = True
    np.testing.assert_array_equal(found.trajectory.bridged, flagged)
    missing = np.isnan(found.trajectory.positions[..., 0])
    assert missing[30:41, 4].all() and missing.sum() == 11
    assert rms_mm(found.trajectory.positions[flagged], truth()[flagged]) < 2.0
    assert found.quality.bridged[2] == pytest.approx(4 / 60)
    assert found.quality.seen[4] == pytest.approx(49 / 60)
    assert found.quality.longest_gap_s[4] == pytest.approx(1.2)
    assert "m5 in only 82%" in found.quality.remarks(NAMES)[-1]
    found.trajectory.save(tmp_path / "t.json")
    assert Trajectory.load(tmp_path / "t.json") == found.trajectory
    jsonschema.validate(
        json.loads((tmp_path / "t.json").read_text()),
        json.loads((SCHEMAS / "trajectory.schema.json").read_text()),
    )


@given(st.lists(st.booleans(), min_size=3, max_size=40), st.floats(0.05, 1.0))
def test_a_bridge_lies_between_two_measurements_and_changes_none(seen: list[bool], longest: float) -> None:
    t = 0.1 * np.arange(len(seen))
    there = np.where(np.array(seen)[:, None, None], np.stack([t, 2 * t], axis=1)[:, None], np.nan)
    motion = Trajectory(("m1",), t, there)
    bridged = motion.bridge(longest)
    flags = bridged.bridged[:, 0]
    assert not (flags & seen).any()
    np.testing.assert_array_equal(bridged.positions[seen], there[seen])
    np.testing.assert_allclose(bridged.positions[flags, 0], np.stack([t, 2 * t], axis=1)[flags], atol=1e-12)
    assert np.isnan(bridged.positions[~flags & ~np.array(seen)]).all()
    known = np.flatnonzero(seen)
    for i in np.flatnonzero(~np.array(seen)):
        before, after = known[known < i], known[known > i]
        close = len(before) > 0 and len(after) > 0 and t[after[0]] - t[before[-1]] <= longest + 1e-9
        assert flags[i] == close


def test_lost_and_repeated_frames_are_counted(filmed: Filmed) -> None:
    _, frames, plane = filmed
    kept = [f for i, f in enumerate(frames[:30]) if i not in (5, 12, 13)]  # three are lost
    kept.insert(10, kept[9])  # with its time
    kept[21] = (kept[21][0], kept[20][1])  # an old picture with a new time
    quality = track_frames(kept, plane, layout=BODY[MARKED]).quality
    assert (quality.dropped_frames, quality.repeated_times, quality.repeated_pictures) == (3, 1, 1)
    assert quality.frames == 27 and quality.rate_hz == pytest.approx(10)
    assert any("3 frames are missing" in r for r in quality.remarks(NAMES))


def test_a_folder_tells_its_own_times(recordings: Path, tmp_path: Path) -> None:
    folder = tmp_path / "timed"
    folder.mkdir()
    times = np.cumsum([0.1, 0.13, 0.07, 0.2])
    with (folder / "times.csv").open("w", newline="") as table:
        rows = csv.writer(table)
        rows.writerow(["file", "t_s"])
        for i, t in enumerate(times):
            (folder / f"{i}.png").write_bytes((recordings / "pictures" / f"frame{i}.png").read_bytes())
            rows.writerow([f"{i}.png", t])
    assert [t for t, _ in open_source(folder)] == pytest.approx(times.tolist())
    (folder / "times.csv").write_text("file,when\n0.png,1\n")
    with raises(InputError, "file.damaged", match=r"times\.csv .*t_s"):
        list(open_source(folder))


class Webcam:
    """Stands in for cv2.VideoCapture: so many frames, stamped by the driver or not."""

    def __init__(self, images: list[Image], stamps: list[float] | None):
        self._images, self._stamps, self.at, self.released = images, stamps, -1, False

    def read(self) -> tuple[bool, Image | None]:
        self.at += 1
        more = self.at < len(self._images)
        return more, self._images[self.at] if more else None

    def get(self, prop: int) -> float:
        return 0.0 if self._stamps is None else 1e3 * self._stamps[self.at]

    def release(self) -> None:
        self.released = True


def test_a_camera_is_filmed_with_its_drivers_times(filmed: Filmed, monkeypatch: pytest.MonkeyPatch) -> None:
    _, frames, _ = filmed
    images = [image for _, image in frames[:6]]
    stamps = [100.0, 100.1, 100.21, 100.3, 100.41, 100.5]
    monkeypatch.setattr("time.monotonic", lambda: 100.3)
    webcam = Webcam(images, stamps)
    times = [t for t, _ in CameraDevice("camera:0", 0.35, open=lambda device: webcam)]
    assert times == pytest.approx([0, 0.1, 0.21, 0.3]) and webcam.released
    assert [
        t for t, _ in CameraDevice("/dev/video1", 1.0, open=lambda device: _counting(webcam, images, device))
    ]
    with raises(InputError, "camera.no-picture", match="any more"):
        list(CameraDevice("camera:0", 9.0, open=lambda device: Webcam(images, stamps)))
    with raises(InputError, "camera.no-picture", match=r"camera:7 .*cable"):
        list(CameraDevice("camera:7", 1.0, open=lambda device: Webcam([], None)))
    assert isinstance(open_source("camera:3", seconds=2.0), CameraDevice)


def _counting(webcam: Webcam, images: list[Image], device: object) -> Webcam:
    assert device == "/dev/video1"
    return Webcam(images, [100.0, 100.1, 100.2, 100.3, 100.4, 101.2])


def test_the_light_may_fall_off_by_two_thirds_over_the_picture() -> None:
    """The colours that were learned in the light hold in the shade."""
    camera = VirtualCamera(9, SPACE)
    shade = np.linspace(1.15, 0.4, 640)[None, :, None] * np.array([0.9, 1.0, 1.1])

    def far(t: float) -> np.ndarray:
        return walk(t) + np.array([0.06 * t - 0.2, 0])

    times = TIMES[::2]
    bright = film(camera, times, far)
    frames = [(t, np.clip(image * shade, 0, 255).astype(np.uint8)) for t, image in bright]
    found = track_frames(
        frames, calibrate_plane([f for _, f in frames[:4]], camera.board), layout=BODY[MARKED]
    )
    assert np.mean(found.quality.seen) > 0.99
    assert rms_mm(found.trajectory.positions, truth(times, far)) < 0.15


def test_a_camera_that_moves_is_named(filmed: Filmed) -> None:
    _, frames, plane = filmed
    assert track_frames(frames, plane, layout=BODY[MARKED]).quality.camera_drift_px < 0.2
    moved = [(t, np.roll(image, 4, axis=1) if t > 3 else image) for t, image in frames]
    with raises(InputError, "camera.moved", match=r"4\.0 s.*found 4\.0 px"):
        track_frames(moved, plane, layout=BODY[MARKED])
    nudged = [(t, np.roll(image, 1, axis=0) if t > 3 else image) for t, image in frames]
    quality = track_frames(nudged, plane, layout=BODY[MARKED]).quality
    assert quality.camera_drift_px == pytest.approx(1.0, abs=0.1)
    assert any("drifted by 1.0 px" in r for r in quality.remarks(NAMES))


def test_tags_that_were_never_seen_tell_no_drift(filmed: Filmed) -> None:
    """The camera may have moved by any distance: null, and not 0.00 px."""
    camera, frames, plane = filmed
    bare = [(t, without_tags(image, camera)) for t, image in frames[:30]]
    quality = track_frames(bare, plane, layout=BODY[MARKED]).quality
    assert quality.to_json()["camera_drift_px"] is None
    remark = "The reference tags were not seen: whether the camera moved is unknown."
    assert remark in quality.remarks(NAMES)
    later = [*bare[:25], *frames[25:50]]  # from 2.5 s on they are seen
    quality = track_frames(later, plane, layout=BODY[MARKED]).quality
    assert 0 <= quality.camera_drift_px < 0.2 and remark not in quality.remarks(NAMES)


def test_tags_that_are_seen_no_more_are_told(filmed: Filmed) -> None:
    """What they showed before says nothing about the time after; hidden for a while they say enough."""
    camera, frames, plane = filmed
    slower = [(4 * t, image) for t, image in frames]
    hidden = [(t, without_tags(image, camera)) for t, image in slower]
    half = len(frames) // 2
    seen = [t for t, _ in slower[:half]]
    quality = track_frames([*slower[:half], *hidden[half:]], plane, layout=BODY[MARKED]).quality
    (remark,) = [r for r in quality.remarks(NAMES) if "reference tags" in r]
    assert remark.endswith(": whether the camera moved later is unknown.")
    (told,) = re.findall(r"last seen at (\d+) s", remark)
    assert seen[-1] - 2.5 <= float(told) <= seen[-1] + 0.5
    hidden_for_a_while = [*slower[: half // 2], *hidden[half // 2 : half], *slower[half:]]
    quality = track_frames(hidden_for_a_while, plane, layout=BODY[MARKED]).quality
    assert not any("reference tags" in r for r in quality.remarks(NAMES))


def test_motion_out_of_the_plane_shows_in_the_size(filmed: Filmed, monkeypatch: pytest.MonkeyPatch) -> None:
    camera, frames, plane = filmed
    steady = track_frames(frames, plane, layout=BODY[MARKED]).quality
    assert max(steady.size_change) < 0.03
    nearer = []
    for t in TIMES.tolist():
        larger = 1 + 0.12 * np.sin(max(t - 0.5, 0))
        monkeypatch.setattr(
            camera, "marker_kind", replace(discs.MARKER, paint=partial(_paint_larger, larger))
        )
        nearer.append((t, camera.render(walk(t), SPRINGS, MARKED)))
    quality = track_frames(nearer, plane, layout=BODY[MARKED]).quality
    assert quality.size_change == pytest.approx([0.12] * 5, abs=0.04)
    assert any("m1, m2, m3, m4, m5 left the plane" in r for r in quality.remarks(NAMES))


def _paint_larger(by: float, name: str, points: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    return discs.MARKER.paint(name, points / by, width / by)


def test_size_tells_no_more_than_the_pixels_do() -> None:
    still = Trajectory(("m1",), np.arange(40) / 10, np.zeros((40, 1, 2)))
    sizes = np.where(np.arange(40) < 30, 1.0, 1.08)[:, None]
    remarks = [TrackingQuality.of(still, sizes, pixels).remarks(("m1",)) for pixels in (0.02, 0.1)]
    assert "m1 left the plane" in str(remarks[0]) and not remarks[1]


def test_quality_of_nothing_is_no_number() -> None:
    quality = TrackingQuality.of(
        Trajectory(("m1",), np.zeros(1), np.full((1, 1, 2), np.nan)), np.full((1, 1), np.nan)
    )
    assert quality.to_json()["size_change"] == [None] and quality.seen == (0.0,)


def test_a_plane_is_calibrated_checked_and_expires(recordings: Path, tmp_path: Path, capsys) -> None:
    out, check = tmp_path / "plane.json", tmp_path / "plane.png"
    calibrate_plane_command(recordings / "walk.mcap", out=out, check=check)
    said = capsys.readouterr().out
    assert "10 tags fit within 0.0" in said and "1.7" in said.split("mm per pixel")[0]
    assert cv2.imread(str(check)).shape == (960, 1280, 3)
    found = Plane.load(out)
    assert found.board is not None and len(found.board.ids) == 10
    jsonschema.validate(json.loads(out.read_text()), json.loads((SCHEMAS / "plane.schema.json").read_text()))
    track_command(recordings / "walk.avi", out=tmp_path / "walk.json", plane=out)
    values = json.loads(out.read_text())
    old = {"expires": (datetime.now(UTC) - timedelta(days=1)).isoformat()}
    out.write_text(json.dumps(values | {"provenance": values["provenance"] | old}))
    with raises(InputError, "camera.expired", match=r"plane\.json "):
        track_command(recordings / "walk.avi", out=tmp_path / "again.json", plane=out)
    with raises(InputError, "log.no-tags"):
        calibrate_plane_command(recordings / "walk.avi", out=tmp_path / "no.json")
    assert not (tmp_path / "no.json").exists()


def test_an_option_that_does_not_count_is_refused(recordings: Path, tmp_path: Path) -> None:
    make_design().save(tmp_path / "design.json")
    (tmp_path / "timed").mkdir()
    (tmp_path / "timed" / "times.csv").write_text("file,t_s\n")
    with Recorder(tmp_path / "with design.mcap") as log:
        log.attach("design.json", (tmp_path / "design.json").read_bytes())
    for source, options, line in (
        (recordings / "walk.mcap", {"seconds": 3.0}, "--seconds is only for cameras"),
        (recordings / "pictures", {"seconds": 10.0, "rate": 10.0}, "--seconds is only for cameras"),
        (recordings / "walk.mcap", {"rate": 5.0}, "--rate is only for pictures without timestamps"),
        (recordings / "walk.avi", {"rate": 5.0}, "--rate is only for pictures without timestamps"),
        (tmp_path / "timed", {"rate": 5.0}, "--rate is only for pictures without timestamps"),
        (recordings / "walk.avi", {"marks": 2, "design": tmp_path / "design.json"}, "--marks is only"),
        (tmp_path / "with design.mcap", {"marks": 2}, "--marks is only for films without a design"),
    ):
        with pytest.raises(typer.BadParameter, match=line):
            track_command(source, out=tmp_path / "walk.json", tags=recordings / "tags.json", **options)
    track_command(recordings / "walk.mcap", out=tmp_path / "walk.json", marks=2)
    assert len(Trajectory.load(tmp_path / "walk.json").positions[0]) == 2


def test_a_calibration_holds_for_its_days() -> None:
    made = validity_period(7)
    now = datetime.now(UTC)
    require_not_expired(made, now + timedelta(days=6.9), "plane.json")
    require_not_expired({}, now, "plane.json")
    with raises(InputError, "camera.expired"):
        require_not_expired(made, now + timedelta(days=7.1), "plane.json")
    with raises(InputError, "file.damaged", match="a date in expires"):
        require_not_expired({"expires": "soon"}, now, "plane.json")


def test_a_recording_knows_when_it_was_made(recordings: Path) -> None:
    now = datetime.now(UTC)
    assert abs(recording_time(open_source(recordings / "walk.avi")) - now) < timedelta(minutes=5)
    assert abs(recording_time(open_source(recordings / "walk.mcap")) - now) < timedelta(minutes=5)  # virtual


def test_the_view_fits_the_predicted_travel() -> None:
    def schedule(**walk: float | None) -> ActuationSchedule:
        predicted = SchedulePrediction.from_json({"method": "search", "displacement": {"search": walk}})
        return ActuationSchedule(20.0, events=(), cycles=10, conditioning_cycles=0, predicted=predicted)

    ahead, behind = visible_range(schedule(mean=1.2, spread=0.2))
    assert ahead == pytest.approx(2 * 1.2 + 3 * 2 * 0.2 + 0.3) and behind == 1.0
    ahead, behind = visible_range(schedule(mean=-1.2, spread=0.0))
    assert ahead == 1.0 and behind == pytest.approx(2.7)
    assert (
        visible_range(schedule(mean=None)) == visible_range(ActuationSchedule(20.0, events=())) == (1.3, 1.3)
    )

"""A calibrated camera is told in its log: CameraInfo as ROS defines it, lens and plane kept and used."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from eldir.errors import InputError
from eldir_calibration.comparison.motions import describe_camera, describe_plane
from eldir_hardware.camera.lens import Lens, validity_period
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.camera.plane_fit import WrongLensError, calibrate_plane
from eldir_hardware.log.messages import camera_info_fields
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.filming import CameraFiles
from eldir_hardware.vision.recording_setup import find_recorded_plane
from eldir_hardware.vision.sources import LoggedFrames
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.camera.lenses import lens_of
from tests.hardware.rigs_and_schedules import rig_text
from tests.hardware.vision.walking_films import SPACE, TIMES, film, without_tags
from tests.raised import raises

SIZE = (640, 480)


def lens(provenance: dict[str, object] | None = None, k1: float = -0.05) -> Lens:
    """Of a camera that bends pictures a little more than the virtual one, so that using it shows."""
    distortion = [k1, 0.02, 0.001, -0.002, 0.01]
    return lens_of(SIZE, [610, 612], [326, 233], distortion, provenance)


@pytest.fixture(scope="module")
def track_run() -> tuple[VirtualCamera, list[Image]]:
    camera = VirtualCamera(7, SPACE)
    return camera, [image for _, image in film(camera, TIMES[:4])]


def record(
    path: Path,
    images: list[Image],
    known: Lens | None = None,
    files: dict[str, object] | None = None,
    epoch_ns: int = 0,
) -> Path:
    with Recorder(path, epoch_ns=epoch_ns, lens=known) as log:
        for name, values in (files or {}).items():
            log.attach(name, json.dumps(values).encode())
        for i, image in enumerate(images):
            log.on_frame(0.1 * i, image)
    return path


def camera_info(path: Path) -> list[object]:
    with AnyReader([path]) as reader:
        topics = [c for c in reader.connections if c.topic == "/camera/camera_info"]
        return [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections=topics)]


def test_rosbags_reads_the_lens_from_camera_info(track_run, tmp_path: Path) -> None:
    (info,) = camera_info(record(tmp_path / "a.mcap", track_run[1][:2], lens()))
    assert (info.width, info.height, info.header.frame_id) == (*SIZE, "camera_optical_frame")
    assert info.distortion_model == "plumb_bob" and info.binning_x == 0
    points = np.random.default_rng(1).uniform([-0.3, -0.3, 0.7], [0.3, 0.3, 1.3], (20, 3))
    still = np.zeros(3)
    seen, _ = cv2.projectPoints(points, still, still, info.k.reshape(3, 3), info.d)
    expected, _ = cv2.projectPoints(points, still, still, lens().matrix, lens().distortion)
    np.testing.assert_array_equal(seen, expected)
    np.testing.assert_array_equal(info.r.reshape(3, 3), np.eye(3))
    # P projects points to the pixels of a rectified picture: those of the same camera without distortion.
    straight = np.column_stack([points, np.ones(20)]) @ info.p.reshape(3, 4).T
    expected, _ = cv2.projectPoints(points, still, still, lens().matrix, None)
    np.testing.assert_allclose(straight[:, :2] / straight[:, 2:], expected[:, 0])


def test_the_mcap_reader_finds_the_lens_file(track_run, tmp_path: Path) -> None:
    with record(tmp_path / "a.mcap", track_run[1][:1], lens()).open("rb") as file:
        (kept,) = make_reader(file).iter_attachments()
    assert (kept.name, kept.media_type) == ("camera.json", "application/json")
    (tmp_path / "camera.json").write_bytes(kept.data)
    assert Lens.load(tmp_path / "camera.json") == lens()


def test_a_camera_without_a_lens_file_is_not_calibrated(track_run, tmp_path: Path) -> None:
    """As ROS has it: D, K, R and P zeroed out, and K[0] = 0 in particular."""
    path = record(tmp_path / "a.mcap", track_run[1][:1])
    (info,) = camera_info(path)
    assert (info.width, info.height) == SIZE
    assert not info.k.any() and not info.r.any() and not info.p.any() and not len(info.d)
    assert describe_camera(LoggedFrames(read_log(path))).startswith("not calibrated: no lens file")


def test_a_lens_of_another_size_is_refused(track_run, tmp_path: Path) -> None:
    with raises(InputError, "camera.other-size", match="640 x 480 pixels; found 320 x 240"):
        record(tmp_path / "a.mcap", [track_run[1][0][::2, ::2]], lens())


def test_the_plane_of_a_log_is_found_with_its_lens(track_run, tmp_path: Path) -> None:
    camera, images = track_run
    tags = {"tags.json": camera.board.to_json()}
    source = LoggedFrames(read_log(record(tmp_path / "a.mcap", images, lens(), tags)))
    plane = find_recorded_plane(source)
    again = calibrate_plane([image for _, image in source], camera.board, lens=lens())
    np.testing.assert_array_equal(plane.homography, again.homography)
    bare = find_recorded_plane(LoggedFrames(read_log(record(tmp_path / "b.mcap", images, None, tags))))
    assert np.abs(plane.radial - bare.radial).max() > 1e-4
    assert "calibrated at an unknown time, focal length 610.0 px, error 0.20 px" in describe_camera(source)
    assert describe_plane(plane) == f"from the log's first frames, 10 tags within {plane.rms_px:.2f} px"


def test_a_lens_that_only_its_camera_reported_is_used_as_a_file_is(track_run, tmp_path: Path) -> None:
    """A log of a ROS graph, whose camera has its own driver: CameraInfo, and no file."""
    camera, images = track_run

    def report(path: Path, images: list[Image]) -> LoggedFrames:
        with Recorder(path) as log:
            log.attach("tags.json", json.dumps(camera.board.to_json()).encode())
            log.on_camera_info(0.0, camera_info_fields(lens(), *SIZE))
            for i, image in enumerate(images):
                log.on_frame(0.1 * i, image)
        return LoggedFrames(read_log(path))

    source = report(tmp_path / "a.mcap", images)
    plane = find_recorded_plane(source)
    again = calibrate_plane([image for _, image in source], camera.board, lens=lens())
    np.testing.assert_array_equal(plane.homography, again.homography)
    told = describe_camera(source)
    assert told == "calibrated, focal length 610.0 px, as camera_info of a.mcap has it; error unknown"
    smaller = report(tmp_path / "b.mcap", [image[:, 8:-8] for image in images])
    assert describe_camera(smaller).startswith("not calibrated"), "pictures of another size"
    find_recorded_plane(smaller)


def test_a_lens_of_another_camera_is_noticed(track_run, tmp_path: Path) -> None:
    """The tags bend otherwise: refused by `eldir calibrate plane`, left aside for a log, and said."""
    camera, images = track_run
    with raises(WrongLensError, "camera.wrong-lens", match="px at the outermost tag"):
        calibrate_plane(images, camera.board, lens=lens(k1=-0.3))
    tags = {"tags.json": camera.board.to_json()}
    plane = find_recorded_plane(
        LoggedFrames(read_log(record(tmp_path / "a.mcap", images, lens(k1=-0.3), tags)))
    )
    bare = find_recorded_plane(LoggedFrames(read_log(record(tmp_path / "b.mcap", images, None, tags))))
    np.testing.assert_array_equal(plane.homography, bare.homography)
    assert plane.provenance["remark"].startswith(
        "The log's lens is not used: the calibration is that of another"
    )


def test_a_plane_kept_with_a_log_is_used_until_the_camera_moves(track_run, tmp_path: Path) -> None:
    camera, images = track_run
    made = validity_period(7)
    kept = calibrate_plane(images[:3], camera.board, made)
    files = {"tags.json": camera.board.to_json(), "plane.json": kept.to_json()}
    found = find_recorded_plane(LoggedFrames(read_log(record(tmp_path / "a.mcap", images, files=files))))
    assert found == kept and describe_plane(found).startswith(f"calibrated {made['made']}, 10 tags")
    moved = [np.roll(image, 9, axis=1) for image in images]
    found = find_recorded_plane(LoggedFrames(read_log(record(tmp_path / "b.mcap", moved, files=files))))
    middle = np.array([0.1, 0.1])
    np.testing.assert_allclose(found.to_pixels(middle) - kept.to_pixels(middle), [9, 0], atol=0.3)
    assert describe_plane(found).startswith("from the log's first frames")
    assert found.provenance["remark"].startswith("The camera had moved")


def test_a_plane_whose_tags_are_not_seen_says_that_it_is_unchecked(track_run, tmp_path: Path) -> None:
    """The camera was moved a tenth nearer after the tags were taken away."""
    camera, images = track_run
    kept = calibrate_plane(images[:3], camera.board)
    nearer = cv2.getRotationMatrix2D((320, 240), 0.0, 1.1)
    bare = [cv2.warpAffine(without_tags(image, camera), nearer, SIZE) for image in images]
    files = {"tags.json": camera.board.to_json(), "plane.json": kept.to_json()}
    found = find_recorded_plane(LoggedFrames(read_log(record(tmp_path / "a.mcap", bare, files=files))))
    np.testing.assert_array_equal(found.homography, kept.homography)
    assert found.provenance["remark"].startswith("The first picture does not show the reference tags")


def test_a_calibration_that_had_expired_is_refused(track_run, tmp_path: Path) -> None:
    camera, images = track_run
    old = datetime.now(UTC) - timedelta(days=1)
    stale = lens({"expires": old.isoformat()})
    epoch = round(1e9 * datetime.now(UTC).timestamp())
    path = record(tmp_path / "a.mcap", images[:1], stale, {"tags.json": camera.board.to_json()}, epoch)
    with raises(InputError, "camera.expired", match="camera.json in "):
        find_recorded_plane(LoggedFrames(read_log(path)))
    before = round(1e9 * (old - timedelta(days=1)).timestamp())
    path = record(tmp_path / "b.mcap", images, stale, {"tags.json": camera.board.to_json()}, before)
    find_recorded_plane(LoggedFrames(read_log(path)))


def test_a_rig_names_its_cameras_files(track_run, tmp_path: Path) -> None:
    lens().save(tmp_path / "camera.json")
    Plane(*SIZE, np.eye(3), [320, 240], [0, 0], 0.1).save(tmp_path / "plane.json")
    rig_path = tmp_path / "rig.yaml"

    def files(**camera: object) -> CameraFiles:
        values = yaml.safe_load(rig_text()) | {"camera": {"kind": "virtual", **camera}}
        rig_path.write_text(yaml.safe_dump(values))
        return CameraFiles.load(Rig.load(rig_path), rig_path)

    assert files() == CameraFiles()
    found = files(lens="camera.json", plane="plane.json")
    assert found.lens == lens() and found.plane == Plane.load(tmp_path / "plane.json")
    with raises(InputError, "camera.other-size", match="lens .*found 320 x 240"):
        files(lens="camera.json", width=320, height=240)
    with raises(InputError, "camera.other-size", match="plane .*found 320 x 240"):
        files(plane="plane.json", width=320, height=240)
    with raises(InputError, "file.other-format", match=r"plane\.json.*eldir-camera/1"):
        files(lens="plane.json")
    with raises(InputError, "file.missing", match=r"none\.json"):
        files(lens="none.json")

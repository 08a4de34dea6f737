"""Every installed kind of marker: printed, rendered, tracked, chosen by the rig file."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer

from eldir.core.yaml_files import parse_yaml
from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir.trajectory import Trajectory
from eldir_app.commands.markers import markers as markers_command
from eldir_app.commands.track import track as track_command
from eldir_calibration.comparison.motions import track_run
from eldir_calibration.comparison.recorded_run import open_run
from eldir_hardware.camera.plane import TagBoard
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.markers.registration import installed_kinds, load_kind
from eldir_hardware.markers.sheet import _rasterise
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.virtual.rig import BodyFrame
from eldir_hardware.vision.pipeline import LiveTracker, track_frames
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.eldir.random_design import make_design
from tests.hardware.markers.other_things_in_view import reflect
from tests.hardware.rigs_and_schedules import gait, rig_text
from tests.hardware.vision.walking_films import BODY, MARKED, SPACE, TIMES, film, truth
from tests.raised import raises

SIZE = (1280, 960)
FRAMES = TIMES[:8:2]


@cache
def _first_camera(kind: str) -> VirtualCamera:
    return VirtualCamera(3, SPACE, size=SIZE, marker=kind)


def a_camera(kind: str) -> VirtualCamera:
    """Each time the same one, which has not taken a picture."""
    return copy.deepcopy(_first_camera(kind))


@pytest.mark.parametrize("kind", installed_kinds())
def test_every_kind_is_tracked_where_the_virtual_camera_shows_it(kind: str) -> None:
    camera = a_camera(kind)
    frames = film(camera, FRAMES)
    plane = calibrate_plane([image for _, image in frames[:2]], camera.board)
    found = track_frames(frames, plane, layout=BODY[MARKED], marker=kind)
    error = np.linalg.norm(found.trajectory.positions - truth(FRAMES), axis=-1)
    print(
        f"{kind}: rms {1e3 * np.sqrt(np.nanmean(error**2)):.3f} mm, worst {1e3 * np.nanmax(error):.3f} mm, "
    )
    assert np.isfinite(error).mean() > 0.97
    assert np.nanmax(error) < 5e-4
    live = LiveTracker(None, plane, BODY[MARKED], kind)
    for t, image in frames[:1]:
        ((_, places, _),) = live.update(round(1e9 * t), image)
        np.testing.assert_allclose(places, found.trajectory.positions[round(t / 0.2)], atol=1e-9)


def test_two_robots_with_the_same_numbers_are_refused() -> None:
    camera = a_camera("aruco")
    frames = film(camera, FRAMES[:1])
    plane = calibrate_plane([image for _, image in frames], camera.board)
    corners = camera.plane.to_pixels(np.array([[-0.03, 0.22], [0.12, 0.0], [0.33, 0.22]]))
    (left, top), (right, bottom), (to, _) = np.round(corners).astype(int)
    for _, image in frames:
        image[top:bottom, to : to + right - left] = image[top:bottom, left:right]
    with raises(InputError, "marks.two-robots", match=r"m1 at x = 0\.0"):
        track_frames(frames, plane, layout=BODY[MARKED], marker="aruco")


def test_the_rig_file_chooses_the_kind() -> None:
    values = parse_yaml(rig_text().encode(), "rig.yaml")
    assert Rig.from_json(values).marker == "discs"  # as before there was a choice
    assert Rig.from_json(values | {"marker": "apriltag"}).marker == "apriltag"
    with raises(InputError, "rig.inconsistent", "marker", match="aruco.*found 'stars'"):
        Rig.from_json(values | {"marker": "stars"})


def test_a_log_is_tracked_with_the_kind_of_its_rig_file(tmp_path: Path) -> None:
    camera = a_camera("aruco")
    with Recorder(tmp_path / "a.mcap") as log:
        log.attach("tags.json", json.dumps(camera.board.to_json()).encode())
        log.attach("rig.yaml", rig_text().encode() + b"\nmarker: aruco\n")
        for t, image in film(camera, FRAMES[:3]):
            log.on_frame(t, image)
    track_command(str(tmp_path / "a.mcap"), out=tmp_path / "a.json")
    positions = Trajectory.load(tmp_path / "a.json").positions
    assert np.isfinite(positions).mean() > 0.6
    assert np.nanmax(np.abs(positions - truth(FRAMES[:3]))) < 5e-4
    with raises(InputError, "marks.not-seen", match="as on the printed sheet"):
        track_command(str(tmp_path / "a.mcap"), out=tmp_path / "b.json", marker="discs")
    with raises(InputError, "input.unknown-name", "kind of marker"):
        track_command(str(tmp_path / "a.mcap"), out=tmp_path / "c.json", marker="stars")


@pytest.mark.parametrize("kind", installed_kinds())
def test_a_printed_marker_is_what_the_tracker_reads(kind: str) -> None:
    """The raster of the sheet, photographed straight on."""
    found = load_kind(kind)
    picture = _rasterise(lambda points, width: found.paint("m2", points, width), found.width)
    assert picture.shape[0] == pytest.approx(found.width / 0.0254 * 600, abs=1)
    if kind == "discs":
        inside = picture[len(picture) // 2, len(picture) // 2]
        assert inside.tolist() == pytest.approx([235, 200, 20], abs=2) and picture[0, 0].tolist() == [255] * 3
        return
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, found.tracker.dictionary))
    white = cv2.copyMakeBorder(picture, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=(255, 255, 255))
    _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(cv2.cvtColor(white, cv2.COLOR_RGB2GRAY))
    assert ids.ravel().tolist() == [41]


def test_another_package_adds_a_kind_while_it_is_on_the_import_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "starry.py").write_text("from eldir_hardware.markers.discs import MARKER\n")
    about = tmp_path / "starry-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: starry\nVersion: 1.0\n")
    points = "[eldir.markers]\nstars = starry:MARKER\nbroken = starry:NONE\n"
    (about / "entry_points.txt").write_text(points)
    before = installed_kinds()
    with monkeypatch.context() as changed:
        changed.syspath_prepend(tmp_path)
        assert set(installed_kinds()) == {*before, "stars", "broken"}
        assert load_kind("stars") is load_kind("discs")
        with raises(InputError, "package.broken", match="broken"):
            load_kind("broken")
    assert installed_kinds() == before


def test_sheets_are_written_in_their_true_size(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    markers_command(out=tmp_path / "sheets", marker=["discs"], tags=5)
    assert sorted(f.name for f in (tmp_path / "sheets").iterdir()) == [
        "discs.pdf",
        "reference-tags.pdf",
    ]
    data = (tmp_path / "sheets" / "reference-tags.pdf").read_bytes()
    assert data.startswith(b"%PDF") and b"/MediaBox [ 0 0 595.27" in data  # A4
    assert b"/Count 2" in data  # four tags of 60 mm with their paper a page
    assert "scale bars of 100 mm" in capsys.readouterr().out
    for options in (
        {"marker": ["stars"]},
        {"dictionary": "DICT_5X"},
        {"tags": 40, "dictionary": "DICT_ARUCO_MIP_16H3"},
    ):
        with pytest.raises((InputError, typer.BadParameter)):
            markers_command(out=tmp_path / "no", **options)
        assert not (tmp_path / "no").exists()


@pytest.mark.parametrize("scale", [0.97, 1.0, 1.04])
def test_a_print_of_wrong_scale_is_told(scale: float) -> None:
    right = TagBoard.around(SPACE)
    camera = VirtualCamera(1, SPACE, board=replace(right, side_m=scale * right.side_m))
    plane = calibrate_plane([image for _, image in film(camera, FRAMES[:1])], right)
    remark = plane.provenance.get("remark", "")
    if scale == 1.0:
        assert not remark
    else:
        measured = float(remark.split("about ")[1].split(" mm")[0])
        assert measured == pytest.approx(1e3 * scale * right.side_m, abs=0.6)
        assert "tag file says 60.0 mm: check the scale bar" in remark


def test_a_reflected_tag_is_not_read() -> None:
    """A table that reflects shows the upper tags upside down, which ArUco reads as the same numbers."""
    camera = VirtualCamera(1005, SPACE)
    plain = film(camera, FRAMES[:2])
    images = [reflect(camera, image, 0.31) for _, image in plain]
    plane = calibrate_plane(images, camera.board)
    grid = np.stack(np.meshgrid(np.linspace(-0.2, 0.5, 5), np.linspace(0, 0.2, 5)), axis=-1)
    assert np.abs(plane.to_metres(camera.plane.to_pixels(grid)) - grid).max() < 5e-4


@pytest.mark.parametrize("kind", ["aruco", pytest.param("apriltag", marks=pytest.mark.stress)])
def test_squares_go_through_the_whole_circle(kind: str, tmp_path: Path) -> None:
    """Driven on the virtual rig, found by the live page's process and by the report, as its log says."""
    design = make_design(3, Lattice(3, 6))
    design.save(tmp_path / "design.json")
    camera = "camera: {kind: virtual, rate_hz: 0.5, width: 1280, height: 960}\nmarker: " + kind
    text = rig_text(seed=1, design="design.json").replace("camera: {kind: virtual, rate_hz: 10}", camera)
    (tmp_path / "rig.yaml").write_text(text)
    rig = Rig.load(tmp_path / "rig.yaml")
    assert rig.marker == kind
    springs = tuple(np.flatnonzero(design.morphology.active).tolist())
    # With more heat this robot falls over and hides its squares.
    short = replace(
        compile_schedule(gait(duty=(0.22, 0.22)), rig, springs=springs), cycles=1, conditioning_cycles=0
    )
    truth_of: list[BodyFrame] = []
    log = tmp_path / "log.mcap"
    drive_rig(
        with_digests(short, rig, design),
        rig,
        tmp_path / "rig.yaml",
        log,
        DriveConfig(on_body=truth_of.append),
    )
    true = np.array([frame.positions[design.marks] for frame in truth_of])

    # It lies on its rear edge from the beginning.
    report = track_run(open_run(log, design), lambda frames: None, through_falls=True)
    tracked = report.motion.trajectory
    error = np.linalg.norm(tracked.positions - true[: len(tracked.times)], axis=-1)
    print(f"{kind}, driven: {np.isfinite(error).mean():.1%} measured, worst {1e3 * np.nanmax(error):.2f} mm")
    assert np.isfinite(error).mean() > 0.97 and np.nanmax(error) < 2e-3  # what is promised of every kind
    assert np.sqrt(np.nanmean(error**2)) < 3e-4
    assert min(report.quality.seen) > 0.9

    command = [sys.executable, "-m", "eldir_app.watch.marker_tracking", str(log)]
    live = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    rows = [json.loads(line) for line in live.stdout.splitlines()]
    places = [row for row in rows if isinstance(row, list)]
    assert len(places) == len(tracked.times), live
    pixels = report.plane.to_pixels(tracked.positions[-1])
    np.testing.assert_allclose(np.array(places[-1][2:], float), pixels, atol=0.5)

"""The lens that a log keeps counts wherever a plane is calibrated from that log."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from typer.testing import CliRunner

from eldir_app.application import application
from eldir_app.watch.marker_tracking import _LogTracker, _select_pictures
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.log import messages as m
from eldir_hardware.log.following import LogFollower
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.vision.sources import LoggedFrames
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.camera.lenses import lens_of
from tests.hardware.log.log_contents import EPOCH
from tests.hardware.vision.walking_films import SPACE, TIMES, film

FRAMES = 12


class Kept(NamedTuple):
    """A log with a lens, and the planes of its first ten pictures with and without that lens."""

    log: Path
    tags: Path
    with_lens: Plane
    without: Plane


def keep(folder: Path, k1: float) -> Kept:
    camera = VirtualCamera(7, SPACE)
    lens = lens_of((640, 480), [610, 612], [326, 233], [k1, 0.02, 0.001, -0.002, 0.01], None)
    log, tags = folder / "a.mcap", folder / "tags.json"
    camera.board.save(tags)
    with Recorder(log, epoch_ns=EPOCH, lens=lens) as recorder:
        recorder.attach("tags.json", json.dumps(camera.board.to_json()).encode())
        for i, (_, image) in enumerate(film(camera, TIMES[:FRAMES])):
            recorder.on_frame(0.1 * i, image)
    images: list[Image] = [image for _, image in LoggedFrames(read_log(log))][:10]
    used = None if k1 < -0.1 else lens
    return Kept(
        log, tags, calibrate_plane(images, camera.board, lens=used), calibrate_plane(images, camera.board)
    )


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Kept:
    found = keep(tmp_path_factory.mktemp("lens"), -0.05)
    assert np.abs(found.with_lens.radial - found.without.radial).max() > 1e-4
    return found


def command(*words: object) -> str:
    result = CliRunner().invoke(application(str(words[0])), [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result.output


def test_track_with_tags_uses_the_lens_of_the_log(kept: Kept, tmp_path: Path) -> None:
    out, plane = tmp_path / "t.json", tmp_path / "p.json"
    command("track", kept.log, "--tags", kept.tags, "--out", out, "--save-plane", plane)
    np.testing.assert_array_equal(Plane.load(plane).homography, kept.with_lens.homography)


def test_calibrate_plane_uses_the_lens_of_the_log(kept: Kept, tmp_path: Path) -> None:
    command("calibrate", "plane", kept.log, "--out", tmp_path / "p.json")
    np.testing.assert_array_equal(Plane.load(tmp_path / "p.json").homography, kept.with_lens.homography)


def test_the_live_page_uses_the_lens_of_the_log(kept: Kept) -> None:
    with LogFollower(str(kept.log), {m.IMAGE}) as log:
        tracker = _LogTracker(log)
        for picture in _select_pictures(log, is_replay=True):
            tracker.update(picture)
    assert tracker._tracker is not None and tracker._tracker.plane is not None
    np.testing.assert_array_equal(tracker._tracker.plane.homography, kept.with_lens.homography)


def test_a_lens_of_another_camera_is_left_out_and_said(tmp_path: Path) -> None:
    """As `eldir track LOG` does without --tags."""
    wrong = keep(tmp_path, -0.3)
    told = command("calibrate", "plane", wrong.log, "--out", tmp_path / "p.json")
    assert "note: The log's lens is not used: the calibration is that of another" in told
    np.testing.assert_array_equal(Plane.load(tmp_path / "p.json").homography, wrong.without.homography)

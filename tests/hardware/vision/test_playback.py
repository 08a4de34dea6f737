"""Sources at their pace, the robot's camera, and the robot in a worker process."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir.lattice import Lattice
from eldir_hardware.images import jpeg
from eldir_hardware.log.messages import camera_info_fields
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.filming import RobotCamera, virtual_camera
from eldir_hardware.virtual.bodies import BodyProcess, EngineBody
from eldir_hardware.vision.pipeline import LiveOverlay
from eldir_hardware.vision.recording_setup import load_recorded_lens
from eldir_hardware.vision.sources import timed_pictures
from tests.eldir.random_design import make_design
from tests.hardware.camera.lenses import lens_of
from tests.hardware.log.log_contents import EPOCH, picture
from tests.hardware.rigs_and_schedules import SCHEDULE, rig_text
from tests.hardware.vision.walking_films import MARKED, NAMES
from tests.raised import raises


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("robot")
    make_design(3, Lattice(3, 6)).save(folder / "design.json")
    (folder / "rig.yaml").write_text(rig_text(seed=4, design="design.json"))
    return folder


def test_a_logs_pictures_keep_their_bytes_and_stamps(tmp_path):
    with Recorder(tmp_path / "log.mcap", epoch_ns=EPOCH) as log:
        for t in (0.5, 0.75, 1.5):
            log.on_frame(t, picture(1))
    shown = list(timed_pictures(str(tmp_path / "log.mcap"), 10.0))
    assert [p.stamp_ns for p in shown] == [EPOCH + round(1e9 * t) for t in (0.5, 0.75, 1.5)]
    np.testing.assert_allclose([p.due for p in shown], [0.0, 0.25, 1.0], atol=1e-6)
    assert {p.data for p in shown} == {jpeg.encode(picture(1)).tobytes()}
    assert load_recorded_lens(str(tmp_path / "log.mcap")) is None


def test_a_log_keeps_the_lens_that_its_camera_reported(tmp_path):
    """As `mcap_recorder` writes it: in CameraInfo, without a file."""
    with Recorder(tmp_path / "log.mcap", epoch_ns=EPOCH) as log:
        log.on_camera_info(0.5, camera_info_fields(None, 64, 48))
        log.on_frame(0.5, picture(1))
    assert load_recorded_lens(str(tmp_path / "log.mcap")) is None, "not calibrated"
    lens = lens_of((64, 48), [94, 94.5], [32.2, 23.5], [-0.1, 0.01, 0, 0, 0])
    with Recorder(tmp_path / "calibrated.mcap", epoch_ns=EPOCH) as log:
        log.on_camera_info(0.5, camera_info_fields(lens, 64, 48))
        log.on_frame(0.5, picture(1))
    kept = load_recorded_lens(str(tmp_path / "calibrated.mcap"))
    assert kept is not None and kept.size == lens.size
    np.testing.assert_array_equal(kept.matrix, lens.matrix)
    np.testing.assert_array_equal(kept.distortion, lens.distortion)
    assert (kept.deviation >= lens.deviation).all()


def test_a_folders_pictures_are_due_at_its_rate(tmp_path):
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), picture(number))
    shown = list(timed_pictures(str(tmp_path), 4.0))
    assert [(p.due, p.stamp_ns) for p in shown] == [(0.0, None), (0.25, None), (0.5, None)]
    assert load_recorded_lens(str(tmp_path)) is None and load_recorded_lens("camera:0") is None
    with raises(InputError, "file.missing"):
        next(timed_pictures(str(tmp_path / "none.mcap"), 4.0))


def test_the_robots_camera_sees_the_robot_as_a_run_does(folder):
    camera = RobotCamera.load(folder / "rig.yaml", folder / "design.json")
    rig, design = Rig.load(folder / "rig.yaml"), Design.load(folder / "design.json")
    body = EngineBody(design.morphology, 4, rig.spring_parameters(), design.ballast / 2)
    image = camera.render(body.positions)
    again = RobotCamera(rig, design).render(body.positions)
    np.testing.assert_array_equal(image, again)
    reference = virtual_camera(rig, rig.camera, body, SCHEDULE)  # type: ignore[arg-type]
    assert image.shape == reference.render(body.positions, body.springs, design.marks).shape
    assert len(camera.board.ids) >= 4


def test_a_body_in_a_worker_process_moves_as_one_in_this_process_and_tells_what_fails(folder):
    design, rig = Design.load(folder / "design.json"), Rig.load(folder / "rig.yaml")
    springs = rig.spring_parameters()
    here = EngineBody(design.morphology, 4, springs, design.ballast / 2)
    with BodyProcess("eldir", design.morphology, 4, springs, design.ballast) as there:
        np.testing.assert_array_equal(there.positions, here.positions)
        np.testing.assert_array_equal(there.springs, here.springs)
        lengths = np.full((5, design.morphology.motors, 2), 0.9 * springs.cold_length)
        here.move(lengths, 0.02)
        there.move(lengths, 0.02)
        np.testing.assert_array_equal(there.positions, here.positions)
        with pytest.raises(InputError, match="expected finite"):
            there.move(np.full((1, design.morphology.motors, 2), np.nan), 0.02)
        with pytest.raises(EldirError, match="process died"):
            there.move(np.full((1, design.morphology.motors, 2), springs.cold_length), 0.02)


def test_an_overlay_is_drawn_again_after_its_period(filmed):
    _, frames, plane = filmed
    overlay = LiveOverlay(NAMES)
    positions = np.zeros((len(MARKED), 2)) + 0.1
    overlay.add(10.0, positions)
    assert overlay.is_due(10.0, 2.0)
    assert overlay.draw(frames[0][1], plane).startswith(b"\x89PNG")
    overlay.add(11.0, positions)
    assert not overlay.is_due(11.0, 2.0) and overlay.is_due(12.0, 2.0)

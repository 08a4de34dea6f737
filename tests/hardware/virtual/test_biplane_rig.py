"""A virtual rig whose robot may leave its plane: each channel heats a coil, and the camera sees the robot
turn, lean and fall."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eldir.core.yaml_files import parse_yaml
from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir.parameters.springs import SpringParameters
from eldir_hardware.camera.projection import DiscPoses, Projection
from eldir_hardware.emulator.board import ContactEvent
from eldir_hardware.images import jpeg
from eldir_hardware.log.reader import read_log
from eldir_hardware.markers.registration import load_kind
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import VirtualCameraEntry
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.run.filming import virtual_camera
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.virtual.biplane_body import BiplaneBody
from eldir_hardware.virtual.mujoco_body import MujocoBody
from eldir_hardware.virtual.rig import BodyFrame, VirtualRig
from eldir_hardware.vision.pipeline import track_frames
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import gait, rig_text
from tests.hardware.vision.walking_films import BODY, MARKED, NAMES, SPACE, SPRINGS

pytest.importorskip("mujoco")  # installed with the extra `test`
DESIGN = make_design(3, Lattice(3, 6))
MOTORS = DESIGN.morphology.motors
COLD, HOT = SpringParameters().cold_length, SpringParameters().hot_length
THICKNESS = 0.0494
"""Of a robot, from outside to outside [m]."""


def rig_3d() -> str:
    text = rig_text(4, "design.json", physics="mujoco").replace("rate_hz: 10}", "rate_hz: 2}")
    return text.rstrip("\n").replace("  physics: mujoco", "  physics: mujoco\n  dimensions: 3") + "\n"


def discs(turn: Rotation, shift: tuple[float, float, float] = (0, 0, 0)) -> DiscPoses:
    """The body of the films with two faces, turned about the middle of its lowest points."""
    middle = np.stack([BODY[:, 0], np.full(len(BODY), THICKNESS / 2), BODY[:, 1]], axis=1)
    outsides = middle[:, None] + np.array([[0.0, -1, 0], [0, 1, 0]]) * THICKNESS / 2
    pivot = np.array([BODY[:, 0].mean(), THICKNESS / 2, 0.0])
    rotations = np.broadcast_to(turn.as_matrix(), (len(BODY), 2, 3, 3))
    return DiscPoses(
        turn.apply((outsides - pivot).reshape(-1, 3)).reshape(-1, 2, 3) + pivot + shift, rotations
    )


def seen_pixels(camera: VirtualCamera, poses: DiscPoses) -> np.ndarray:
    """Where the markers are in the picture, for a tracker that takes the picture's plane for theirs."""
    plane, shown = camera.plane, camera.render_solid(poses, SPRINGS, MARKED)
    tracker = load_kind("discs").tracker(plane, NAMES)
    return plane.to_pixels(tracker.update(shown, 0.0))


@pytest.mark.parametrize("angles", [(0, 0), (25, 0), (0, 12), (-20, -10)], ids=str)
def test_markers_are_where_perspective_has_them(angles: tuple[int, int]) -> None:
    """Yaw and lean [degrees], by a pinhole camera that is written out here."""
    camera = VirtualCamera(3, SPACE)
    poses = discs(Rotation.from_euler("zx", angles, degrees=True), (0.02, 0.03, 0.01))
    fronts, lens = poses.outsides[MARKED, 0], camera.lens
    view = Projection.of(camera.plane, float(lens.focal_px[0]))
    to_optical = view.matrix[:, :3] / np.array(
        [[lens.focal_px[0] / camera.plane.half_diagonal_px]] * 2 + [[1]]
    )
    np.testing.assert_allclose(to_optical @ to_optical.T, np.eye(3), atol=1e-9)
    places = (fronts - view.position) @ to_optical.T
    x, y = (places[:, :2] / places[:, 2:]).T
    k1, k2 = lens.distortion[:2]
    r2 = x**2 + y**2
    expected = lens.centre_px + lens.focal_px * (1 + r2 * (k1 + r2 * k2))[:, None] * np.stack([x, y], axis=1)
    assert np.abs(seen_pixels(camera, poses) - expected).max() < 0.15


def test_an_upright_robot_is_seen_at_its_place_in_the_plane() -> None:
    camera = VirtualCamera(3, SPACE)
    frames = [(0.1 * i, camera.render_solid(discs(Rotation.identity()), SPRINGS, MARKED)) for i in range(3)]
    found = track_frames(frames, camera.plane, layout=BODY[MARKED]).trajectory.positions
    assert np.abs(found - BODY[MARKED]).max() < 2e-4


@pytest.mark.parametrize("lean", [90, -90])
def test_a_robot_that_has_fallen_is_painted_as_fallen(lean: int) -> None:
    """No marker faces the camera, and nothing of the robot is higher than it is thick."""
    camera = VirtualCamera(3, SPACE, noise=0.0)
    poses = discs(Rotation.from_euler("x", lean, degrees=True), (0.0, 0.0, THICKNESS / 2))
    empty = camera.render(BODY[:0], SPRINGS[:0], MARKED[:0])
    shown = camera.render_solid(poses, SPRINGS, MARKED)
    changed = np.abs(shown.astype(int) - empty).max(axis=2) > 8
    assert changed.sum() > 1000
    heights = camera.pixel_positions[changed][:, 1]
    assert heights.max() < 1.4 * THICKNESS < 0.5 * BODY[:, 1].max(), "nearer parts look larger"
    chroma = np.ptp(shown[changed].astype(int), axis=1)
    assert chroma.max() < 40, "no marker's colour"


def test_one_channel_moves_the_coil_of_its_face_alone() -> None:
    class Recorder(MujocoBody):
        moved: np.ndarray

        def move(self, lengths: np.ndarray, interval: float) -> None:
            self.moved = lengths

    rig = Rig.from_json(parse_yaml(rig_3d().encode(), "rig"))
    body = Recorder(DESIGN.morphology, 4, SpringParameters())
    virtual = VirtualRig(rig, body)
    channel = rig.find_channel(1, "back")
    assert channel is not None
    virtual.springs.on_contact_event(ContactEvent(virtual.clock.now(), channel, True))
    virtual.frame(virtual.clock.now() + 4.0)
    own = [spring.cold_length for spring in virtual.springs.parameters]
    longer = body.moved[-1].ravel() - own
    assert longer[3] > 0.01 and np.abs(longer[:3]).max() < 1e-4


def test_coils_of_a_motor_stay_apart_in_space_and_are_averaged_in_the_plane() -> None:
    ours = [BiplaneBody(DESIGN.morphology, 4, SpringParameters()) for _ in range(2)]
    flat = [MujocoBody(DESIGN.morphology, 4, SpringParameters()) for _ in range(2)]
    apart = np.linspace(0, 1, 21)[1:, None, None] * [-0.004, 0.004] + np.full((20, MOTORS, 2), COLD)
    for pair in (ours, flat):
        for body, lengths in zip(
            pair, (apart, apart.mean(axis=2, keepdims=True).repeat(2, axis=2)), strict=True
        ):
            body.move(lengths, 0.05)
    np.testing.assert_array_equal(flat[0].positions, flat[1].positions)
    leaning = [np.abs(body.discs.rotations[..., [0, 2], 1]).max() for body in ours]
    assert leaning[0] > 2 * leaning[1], "faces that pull otherwise turn hubs out of the plane"
    fronts = ours[1].discs.outsides[:, 0]
    assert np.abs(fronts[:, [0, 2]] - flat[1].positions).max() < 0.002 and np.abs(fronts[:, 1]).max() < 0.006


class EnoughError(Exception):
    """As many frames as the test looks at."""


def test_a_run_in_space_is_driven_and_filmed(tmp_path: Path) -> None:
    DESIGN.save(tmp_path / "design.json")
    (tmp_path / "rig.yaml").write_text(rig_3d())
    rig = Rig.load(tmp_path / "rig.yaml")
    motors = tuple(np.flatnonzero(DESIGN.morphology.active).tolist())
    whole = compile_schedule(gait(period=15.0, duty=(0.27, 0.27)), rig, motors)
    schedule = with_digests(replace(whole, conditioning_cycles=0, cycles=1, settle_s=0.5), rig, DESIGN)
    frames: list[BodyFrame] = []

    def watch(frame: BodyFrame) -> None:
        frames.append(frame)
        if len(frames) == 9:
            raise EnoughError

    with suppress(EnoughError):
        drive_rig(schedule, rig, tmp_path / "rig.yaml", tmp_path / "log.mcap", DriveConfig(on_body=watch))
    log = read_log(tmp_path / "log.mcap")
    assert log.frame_count == len(frames) - 1
    flat, poses = frames[-2].positions, frames[-2].discs
    assert poses is not None and rig.camera is not None
    body = BiplaneBody(DESIGN.morphology, 4, SpringParameters(), DESIGN.ballast)
    camera = virtual_camera(rig, VirtualCameraEntry(kind="virtual", rate_hz=2), body, schedule)
    shown = jpeg.decode([data for _, data in log.pictures][-1]).astype(int)
    solid, planar = (
        np.abs(shown - render(where, DESIGN.morphology.springs, DESIGN.marks)).sum()
        for render, where in ((camera.render_solid, poses), (camera.render, flat))
    )
    assert solid < 0.97 * planar


def test_a_rig_file_that_cannot_be_simulated_in_space_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(rig_3d().replace("physics: mujoco", "physics: eldir"))
    with pytest.raises(InputError, match="dimensions: 3 needs physics: mujoco"):
        Rig.load(path)
    one_face = "\n".join(line for line in rig_3d().splitlines() if "channel: 4" not in line)
    path.write_text(one_face)
    with pytest.raises(InputError, match="a channel for each face of every motor"):
        Rig.load(path)

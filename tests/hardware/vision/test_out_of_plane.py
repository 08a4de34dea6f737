"""What markers tell of a robot that turns, leans, comes nearer or falls: compared with where it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eldir.trajectory import Trajectory
from eldir_hardware.camera.projection import DiscPoses, Projection
from eldir_hardware.vision.out_of_plane import PlaneDeparture, PlaneObserver
from eldir_hardware.vision.pipeline import track_frames
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.vision.walking_films import BODY, MARKED, NAMES, SPACE, SPRINGS

CAMERA = VirtualCamera(3, SPACE)
FOCAL = float(CAMERA.lens.focal_px[0])
VIEW = Projection.of(CAMERA.plane, FOCAL)
DISTANCE = -float(VIEW.position[1])
STRIPS = np.array([[0, 1], [1, 2], [2, 3], [3, 4]])
HALF_WIDTH = 0.0247


def fronts(yaw: float, lean: float, depth: float, ahead: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Markers of the films' body (5, 3) [m] and the rotation: yaw and lean [degrees], depth of its markers in
    the mean as a share of the camera's distance, and how far it walked [m]."""
    turn = Rotation.from_euler("zx", [yaw, lean], degrees=True)
    at = np.stack([BODY[MARKED][:, 0], np.zeros(len(MARKED)), BODY[MARKED][:, 1]], axis=1)
    middle = at.mean(axis=0)
    return turn.apply(at - middle) + middle + [ahead, depth * DISTANCE, 0.0], turn.as_matrix()


def observe(*end: float, focal: float | None = FOCAL, noise: float = 0.0) -> PlaneDeparture:
    """Of a robot that stands as it was put for a second, then otherwise; its markers as tracked."""
    rng, places, sizes = np.random.default_rng(1), [], []
    for pose in [(0.0, 0.0, 0.0, 0.0)] * 11 + [end] * 10:
        where, turn = fronts(*pose)
        seen = CAMERA.plane.to_metres(VIEW.to_pixels(where))
        places.append(seen + rng.normal(0, noise, seen.shape))
        upright = VIEW.faces_camera(where, np.array([0.0, -1.0, 0.0]))
        area = VIEW.faces_camera(where, -turn[:, 1]) / upright
        sizes.append(np.sqrt(area) * DISTANCE / (DISTANCE + where[:, 1]))
    path = Trajectory(NAMES, np.arange(21) / 10, np.array(places))
    found = PlaneObserver(path, np.array(sizes), STRIPS, CAMERA.plane, focal).estimate(1.15, 2.05)
    assert found is not None
    return found


@pytest.mark.parametrize(
    "pose",
    [(0, 0, 0, 0.1), (0, 0, 0.04, 0.1), (0, 0, -0.05, 0), (40, 0, 0, 0), (-20, 8, 0, 0.1), (0, -18, 0, 0)],
    ids=str,
)
@pytest.mark.parametrize("focal", [FOCAL, None])
def test_the_intervals_hold_what_is_true(pose: tuple[float, ...], focal: float | None) -> None:
    found = observe(*pose, focal=focal, noise=5e-5)
    for interval, true, grid in (
        (found.yaw, abs(np.radians(pose[0])), np.radians(2.5)),
        (found.lean, abs(np.radians(pose[1])), np.radians(1.25)),
        (found.depth, pose[2], 0.0025),
    ):
        assert interval.low - grid <= true <= interval.high + grid
    assert found.depth.high - found.depth.low < 0.065 and found.lean.high < np.radians(25)
    assert any(pose[:3]) >= found.is_certain, "a robot in its plane is not said to have left it"
    assert found.is_certain >= (abs(pose[2]) > 0.03 or abs(pose[0]) > 35 or abs(pose[1]) > 15)


@pytest.mark.parametrize("pose", [(25, 0, 0, 0.1), (-15, 5, 0.03, 0.2), (0, 0, -0.05, -0.1)], ids=str)
def test_the_error_of_a_path_is_within_the_bound(pose: tuple[float, ...]) -> None:
    """Where a tracker has the markers, against where the robot's middle is."""
    where, turn = fronts(*pose)
    half_length = 0.125
    seen = CAMERA.plane.to_metres(VIEW.to_pixels(where))[:, 0].mean()
    middle = where.mean(axis=0) + turn @ [half_length, HALF_WIDTH, 0.0]
    start = fronts(0, 0, 0)[0].mean(axis=0)[0] + half_length
    error = abs((seen - BODY[MARKED][:, 0].mean()) - (middle[0] - start))
    found = observe(*pose)
    assert 0.001 < error < found.path_error(HALF_WIDTH, half_length) < 0.06


def test_without_strips_or_markers_nothing_is_said() -> None:
    path = Trajectory(NAMES, np.arange(21) / 10, np.tile(BODY[MARKED], (21, 1, 1)))
    sizes = np.ones((21, len(MARKED)))
    assert PlaneObserver(path, sizes, STRIPS[:0], CAMERA.plane).estimate(1.0, 2.0) is None
    unseen = replace(path, positions=np.full_like(path.positions, np.nan))
    blind = PlaneObserver(unseen, sizes * np.nan, STRIPS, CAMERA.plane)
    assert blind.estimate(1.0, 2.0) is None and blind.find_loss() is None


def standing(lean: float, side: int) -> DiscPoses:
    """The films' body with two faces, that turns by `lean` [degrees] about the lower edge of its front or
    back."""
    middle = np.stack([BODY[:, 0], np.full(len(BODY), HALF_WIDTH), BODY[:, 1]], axis=1)
    outsides = middle[:, None] + np.array([[0.0, -1, 0], [0, 1, 0]]) * HALF_WIDTH
    turn, pivot = Rotation.from_euler("x", side * lean, degrees=True), [0.0, (1 - side) * HALF_WIDTH, 0.0]
    rotations = np.broadcast_to(turn.as_matrix(), (len(BODY), 2, 3, 3))
    return DiscPoses(turn.apply((outsides - pivot).reshape(-1, 3)).reshape(-1, 2, 3) + pivot, rotations)


@pytest.mark.parametrize("side", [1, -1], ids=["to the camera", "away"])
def test_a_fall_is_found_when_it_happens_and_a_covered_robot_has_not_fallen(side: int) -> None:
    """The robot falls in 0.6 s, as a rod of its height does; ten pictures a second."""
    times = np.arange(30) / 10
    leans = 90 * np.clip((times - 1.4) / 0.6, 0, 1) ** 2
    still = CAMERA.render_solid(standing(0.0, side), SPRINGS, MARKED)
    frames = [
        (float(t), still if lean == 0 else CAMERA.render_solid(standing(lean, side), SPRINGS, MARKED))
        for t, lean in zip(times, leans, strict=True)
        if lean > 0 or t > 1.15 or t < 0.3
    ]
    found = track_frames(frames, CAMERA.plane, layout=BODY[MARKED])
    observer = PlaneObserver(found.trajectory, found.sizes, STRIPS, CAMERA.plane)
    loss = observer.find_loss()
    assert loss is not None and loss.fell and 1.7 < loss.last_seen_s < 2.0
    covered = found.trajectory.positions.copy()
    covered[found.trajectory.times > 1.45] = np.nan
    gone = replace(found.trajectory, positions=covered)
    loss = PlaneObserver(gone, found.sizes, STRIPS, CAMERA.plane).find_loss()
    assert loss is not None and not loss.fell and loss.last_seen_s == pytest.approx(1.4)
    back = np.where(np.isnan(covered), BODY[MARKED], covered)
    assert PlaneObserver(replace(gone, positions=back), found.sizes, STRIPS, CAMERA.plane).find_loss() is None

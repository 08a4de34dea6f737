"""Where the camera stands: planes made from known poses, and points projected through the frames."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eldir_hardware.camera.plane import FieldOfView, Plane, estimate_camera_pose, to_quaternion
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.vision.virtual_camera import VirtualCamera

SIZE, FOCAL = (640, 480), 850.0
CENTRE = np.array([322.0, 236.0])
UNIT = np.hypot(*SIZE) / 2


def frames(angles, position):
    """Rotation from the optical frame to the ground's, of a camera that looks along y, turned a little."""
    looking = np.column_stack([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # right, down, ahead
    return Rotation.from_euler("xyz", angles, degrees=True).as_matrix() @ looking, np.array(position)


def pixels_of(points, rotation, position):
    """Pinhole projection of points (N, 3) in the ground's frame."""
    x, y, z = ((points - position) @ rotation).T
    return CENTRE + FOCAL * np.column_stack([x / z, y / z])


@pytest.mark.parametrize("angles", [(0, 0, 0), (6, -3, 12), (-8, 5, -20)])
def test_the_pose_of_a_camera_is_that_which_made_the_plane(angles):
    rotation, position = frames(angles, (0.1, -0.8, 0.15))
    corners = np.array([(x, y) for x in (-0.2, 0.4) for y in (0.0, 0.3)])
    inside = np.column_stack([corners[:, 0], np.zeros(4), corners[:, 1]])
    seen = (pixels_of(inside, rotation, position) - CENTRE) / UNIT
    rows = [
        row
        for (x, y), (u, v) in zip(corners, seen, strict=True)
        for row in ((x, y, 1, 0, 0, 0, -u * x, -u * y, -u), (0, 0, 0, x, y, 1, -v * x, -v * y, -v))
    ]
    homography = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    for sign in (1.0, -1.0):
        plane = Plane(*SIZE, sign * homography, CENTRE, np.zeros(2), 0.0)
        pose = estimate_camera_pose(plane, FOCAL)
        np.testing.assert_allclose(pose.position, position, atol=1e-9)
        np.testing.assert_allclose(pose.rotation, rotation, atol=1e-9)


def test_the_pose_found_from_pictures_is_that_of_the_virtual_camera():
    view = FieldOfView(-0.3, 0.5, 0.2)
    camera = VirtualCamera(3, view)
    nothing = np.zeros((0, 2), int)
    pictures = [camera.render(np.full((1, 2), 9.0), nothing, np.zeros(0, int)) for _ in range(5)]
    focal = float(camera.lens.focal_px.mean())
    found = estimate_camera_pose(calibrate_plane(pictures, camera.board, lens=camera.lens), focal)
    true = estimate_camera_pose(camera.plane, focal)
    assert -3.0 < true.position[1] < -0.3, "in front of the plane: y points away from the camera"
    np.testing.assert_allclose(found.position, true.position, atol=0.01)
    assert np.degrees(np.arccos((np.trace(found.rotation.T @ true.rotation) - 1) / 2)) < 0.6


@pytest.mark.parametrize(
    "angles", [(0, 0, 0), (180, 0, 0), (0, 180, 0), (0, 0, 180), (10, 20, 30), (90, 0, 90)]
)
def test_a_quaternion_is_its_rotation(angles):
    rotation = Rotation.from_euler("xyz", angles, degrees=True)
    q = to_quaternion(rotation.as_matrix())
    np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), rotation.as_matrix(), atol=1e-12)
    assert np.linalg.norm(q) == pytest.approx(1.0) and q[3] >= 0

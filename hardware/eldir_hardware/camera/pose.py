"""Where a camera stands in front of the plane of motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from eldir.core.records import FloatArray
from eldir_hardware.camera.plane import Plane


class CameraPose(NamedTuple):
    """A camera in the frame of the ground: x forward in the plane, y away from the camera, z up."""

    position: FloatArray
    """Its centre of projection [m], shape (3,)."""
    rotation: FloatArray
    """From the optical frame (x right, y down, z into the picture) to the ground's, shape (3, 3)."""


def camera_pose(plane: Plane, focal: float) -> CameraPose:
    """The pose that a calibrated plane implies for a camera of this focal length [px].

    The homography is a multiple of diag(f, f, 1) [r1 r2 t], with r1 and r2 the plane's axes and t its origin
    in the optical frame. The nearest rotation is taken, since noise leaves r1 and r2 not quite upright.
    """
    f = focal / plane.unit
    h = np.diag([1 / f, 1 / f, 1.0]) @ plane.homography
    h = h / np.sqrt(np.linalg.norm(h[:, 0]) * np.linalg.norm(h[:, 1]))
    if h[2, 2] + h[2, :2] @ _seen(plane) < 0:  # the plane is before the camera
        h = -h
    right, up = h[:, 0], h[:, 1]
    u, _, v = np.linalg.svd(np.column_stack([right, -np.cross(right, up), up]))
    to_optical = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return CameraPose(-to_optical.T @ h[:, 2], to_optical.T)


def _seen(plane: Plane) -> FloatArray:
    """A point of the plane in the middle of the picture [m], shape (2,)."""
    return plane.to_metres((np.array(plane.size) - 1.0) / 2)


def quaternion(rotation: FloatArray) -> tuple[float, float, float, float]:
    """x, y, z, w of a rotation matrix (3, 3), w not negative."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat(canonical=True).tolist()
    return x, y, z, w

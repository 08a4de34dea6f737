"""Points in space before a camera: what leaves the plane of motion, and flat surfaces that face elsewhere.

Axes: x forward in the plane of motion, y from the plane away from the camera, z up; the ground's origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eldir.core.records import FloatArray
from eldir_hardware.camera.plane import Plane, estimate_camera_pose


class DiscPoses(NamedTuple):
    """Where the discs of a robot with two faces are."""

    outsides: FloatArray
    """Middles of the discs' outer sides, front and back [m], shape (M, 2, 3). The plane of motion (y = 0) is
    that of the front outsides of a robot that stands upright."""
    rotations: FloatArray
    """Rotations of the discs from the upright robot, shape (M, 2, 3, 3)."""


@dataclass(frozen=True)
class Projection:
    """Maps points in space to the pixels of one camera."""

    plane: Plane
    """Its plane of motion, with the distortion."""
    matrix: FloatArray
    """From (x, y, z, 1) [m] to homogeneous u, as the plane's homography; the third is the distance from the
    camera along its axis [m]. Shape (3, 4)."""
    position: FloatArray
    """Centre of projection [m], shape (3,)."""

    @classmethod
    def of(cls, plane: Plane, focal: float) -> Projection:
        """The camera with this focal length [px] that has this plane."""
        pose = estimate_camera_pose(plane, focal)
        scale = np.diag([focal / plane.half_diagonal_px] * 2 + [1.0])
        view = scale @ pose.rotation.T
        return cls(plane, np.column_stack([view, -view @ pose.position]), pose.position)

    def to_pixels(self, points: FloatArray) -> FloatArray:
        """Pixels of points (..., 3) [m] before the camera, shape (..., 2)."""
        u = points @ self.matrix[:, :3].T + self.matrix[:, 3]
        return self.plane.distort(u[..., :2] / u[..., 2:])

    def distances(self, points: FloatArray) -> FloatArray:
        """Distances of points (..., 3) from the camera along its axis [m], shape (...)."""
        return np.asarray(points @ self.matrix[2, :3] + self.matrix[2, 3])

    def surface(self, origin: FloatArray, axes: FloatArray) -> Plane:
        """A flat surface as the camera sees it: a plane whose points are given by their coordinates from the
        `origin` (3,) along two `axes` (3, 2) [m]."""
        own = self.matrix @ np.vstack([np.column_stack([axes, origin]), [0.0, 0.0, 1.0]])
        return Plane(*self.plane.size, own, self.plane.centre_px, self.plane.radial, 0.0)

    def faces_camera(self, origins: FloatArray, normals: FloatArray) -> FloatArray:
        """Cosine of the angle between the normals (..., 3) of surfaces at `origins` (..., 3) and the way to
        the camera, shape (...); the front is seen where it is positive."""
        ways = self.position - origins
        return np.asarray((ways * normals).sum(-1) / np.linalg.norm(ways, axis=-1))

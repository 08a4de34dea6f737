"""Paints a robot with two faces as a camera sees it: discs, strips and connectors in space, and its markers.

Convex parts are painted from the farthest to the nearest, by their nearest corner. Markers lie on the front
discs and are painted last, where these face the camera: another part that covers one does not hide it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from eldir.core.records import FloatArray, IntArray
from eldir_cad.kit.specification import Specification, load_specification
from eldir_hardware.camera.plane import Plane
from eldir_hardware.camera.projection import DiscPoses, Projection

_DISC_GREY, _STRIP_GREY, _CONNECTOR_GREY = 0.78, 0.65, 0.6
"""Linear reflectance."""
_MIN_COSINE = 0.05
"""A marker that is seen at a flatter angle than this is not painted: it is a line."""
_FRACTION_BITS = 4  # of OpenCV's corners

Picture = NDArray[Any]
"""Linear reflectance, float32."""


class Solids(NamedTuple):
    """Convex parts of a robot."""

    corners: tuple[FloatArray, ...]
    """Corners of each part [m], shape (C, 3)."""
    greys: FloatArray
    """Linear reflectance of each, shape (P,)."""


class RobotShape:
    """The shapes of the printed parts, between the discs of a robot."""

    def __init__(self, spec: Specification | None = None):
        spec = spec or load_specification()
        self._socket = 5e-4 * spec.mass.across_flats
        self._radius = 2 * self._socket / np.sqrt(3)
        self._thickness = 1e-3 * spec.mass.height
        self._column = 5e-4 * spec.connector.column_diameter
        self._strip = 5e-4 * np.array([spec.strip.thickness, spec.strip.height])
        self._strip_depth = 1e-3 * (spec.outside - spec.springs_at)

    def solids(self, discs: DiscPoses, springs: IntArray) -> Solids:
        """All parts; coils are drawn as strips, as those of a robot in its plane."""
        outsides, rotations = discs
        inward = np.stack([rotations[:, 0, :, 1], -rotations[:, 1, :, 1]], axis=1)
        angles = np.pi / 3 * np.arange(6)
        hexagon = np.stack([np.cos(angles), np.zeros(6), np.sin(angles)], axis=1)
        rim = np.einsum("mfij,cj->mfci", rotations, hexagon)
        insides = outsides + self._thickness * inward
        outer = outsides[:, :, None] + self._radius * rim
        inner = insides[:, :, None] + self._radius * rim
        prisms = np.concatenate([outer, inner], axis=2).reshape(-1, 12, 3)
        columns = (insides[:, :, None] + self._column * rim).reshape(-1, 12, 3)
        strips = self._strips(outsides + self._strip_depth * inward, inward, springs)
        parts = (prisms, _DISC_GREY), (columns, _CONNECTOR_GREY), (strips, _STRIP_GREY)
        greys = np.concatenate([np.full(len(corners), grey) for corners, grey in parts])
        return Solids(tuple(part for corners, _ in parts for part in corners), greys)

    def _strips(self, ends: FloatArray, inward: FloatArray, springs: IntArray) -> FloatArray:
        """Boxes between the rims of discs, of both faces, shape (2S, 8, 3). `ends`: middles of the discs, in
        the depth of the strips [m], shape (M, 2, 3)."""
        a, b = ends[springs].transpose(1, 0, 2, 3)
        into = self._socket * (b - a) / np.linalg.norm(b - a, axis=-1, keepdims=True)
        a, b = a + into, b - into
        depth = inward[springs].mean(axis=1)
        across = np.cross(b - a, depth)
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        thick, high = self._strip
        corners = [
            end + s * thick * across + d * high * depth for end in (a, b) for s in (-1, 1) for d in (-1, 1)
        ]
        return np.stack(corners, axis=2).reshape(-1, 8, 3)


def marker_surface(view: Projection, discs: DiscPoses, mass: int) -> Plane | None:
    """The front of a mass's front disc, from its middle, forward and up; None where the camera does not see
    it."""
    origin, axes = discs.outsides[mass, 0], discs.rotations[mass, 0]
    if view.faces_camera(origin, -axes[:, 1]) < _MIN_COSINE:
        return None
    return view.surface(origin, axes[:, [0, 2]])


def bounding_box(
    pixels: FloatArray, margin: float, size: tuple[int, int]
) -> tuple[int, int, int, int] | None:
    """Box of a picture's pixels from (x0, y0) to before (x1, y1) around pixels (N, 2); None outside of it."""
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    if not len(pixels):
        return None
    x0, y0 = np.maximum(np.floor(pixels.min(axis=0) - margin), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(pixels.max(axis=0) + margin) + 1, size).astype(int)
    return None if x0 >= x1 or y0 >= y1 else (x0, y0, x1, y1)


def paint_solids(
    albedo: Picture, origin: tuple[int, int], view: Projection, solids: Solids, subpixels: int
) -> None:
    """Paint parts into a reflectance (h, w, 3) whose first pixel is `origin`."""
    shape = albedo.shape[0] * subpixels, albedo.shape[1] * subpixels
    cover, grey = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    nearest = [float(view.distances(corners).min()) for corners in solids.corners]
    for i in np.argsort(nearest)[::-1].tolist():
        pixels = (view.to_pixels(solids.corners[i]) - origin + 0.5) * subpixels - 0.5
        outline = cv2.convexHull(np.round(pixels * 2**_FRACTION_BITS).astype(np.int32))
        cv2.fillConvexPoly(cover, outline, 255, shift=_FRACTION_BITS)
        cv2.fillConvexPoly(grey, outline, round(255 * float(solids.greys[i])), shift=_FRACTION_BITS)
    size = albedo.shape[1], albedo.shape[0]
    part, painted = (
        cv2.resize(fine, size, interpolation=cv2.INTER_AREA).astype(np.float32)[..., None] / 255
        for fine in (cover, grey)
    )
    albedo *= 1 - part
    albedo += painted

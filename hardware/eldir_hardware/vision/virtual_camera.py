"""A camera in software: what a webcam on a tripod would see of a robot in its plane of motion.

Lens, pose, light, exposure, ink and noise are drawn from a seed; nothing else reads them. Not modelled:
motion blur, rolling shutter, specular light, thickness of the robot, focus that varies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eldir.core.arguments import require_value
from eldir.core.records import FloatArray, IntArray
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import FieldOfView, Image, Plane, TagBoard
from eldir_hardware.markers.mark_sheet import PALETTE
from eldir_hardware.markers.painted_squares import paint_square, square_cells
from eldir_hardware.markers.registration import DEFAULT, marker_kind

_Picture = NDArray[Any]  # float32

HEXAGON = 0.00693
"""Circumscribed radius of a mass as printed [m]."""
STRIP = 0.001
"""Thickness of a strip as printed [m]."""
_FINE = 4
"""Subpixels along a pixel's side; discs have soft edges within these, so their centres are exact."""
_PAPER_BORDER = 0.22
"""By how much the paper of a reference tag is wider than the tag, on each side [sides]."""


@dataclass(frozen=True)
class _Secrets:
    """Properties of the camera that the tracker does not know."""

    focal: float  # [px]
    lens: Plane  # exact here; `calibrate_plane` has to find it again
    light: _Picture  # relative illumination by channel, shape (H, W, 3)
    inks: dict[str, _Picture]  # of each marker, relative to the printed colours, shape (3,)
    tone: float  # exponent from linear light to picture values
    blur: float  # optical, standard deviation [px]


class VirtualCamera:
    """Renders a robot and the tag board behind it; the same seed gives the same bytes."""

    def __init__(
        self,
        seed: int,
        workspace: FieldOfView,
        *,
        board: TagBoard | None = None,
        size: tuple[int, int] = (640, 480),
        rate: float = 10.0,
        noise: float = 1.5,
        marker: str = DEFAULT,
    ):
        """`rate` in frames a second; `noise` is the sensor's, a standard deviation in grey levels; `marker`:
        the kind of marker on the masses."""
        self._marker = marker_kind(marker)
        self.board = board or TagBoard.around(workspace)
        self.size = size
        self.rate = rate
        rng = np.random.default_rng([seed, 0xCA3E7A])
        self._rng = np.random.default_rng([seed, 1])
        focal, lens = _pose(rng, self.board, size)
        self._secrets = _Secrets(
            focal,
            lens,
            _light(rng, size),
            {name: rng.uniform(0.85, 1.1, 3).astype(np.float32) for name in PALETTE},
            tone=1 / rng.uniform(1.7, 2.2),
            blur=rng.uniform(0.7, 0.9),
        )
        columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
        # Where each pixel lies in the plane, and its change to the next pixel, each (H, W, 2) [m].
        self._at = lens.to_metres(np.stack([columns, rows], axis=-1))
        self._right = np.gradient(self._at, axis=1)
        self._down = np.gradient(self._at, axis=0)
        self._empty = self._paint_background()
        blurred = cv2.GaussianBlur(self._empty, (0, 0), self._secrets.blur)
        self._developed = self._develop(blurred, self._secrets.light)
        # Twice as wide and high as a frame; every frame takes another window of it.
        self._grain = rng.normal(0.0, noise, (2 * size[1], 2 * size[0], 3)).astype(np.float32)

    @property
    def lens(self) -> Lens:
        """What a perfect calibration of this camera would find; the tracker does not get it."""
        plane, focal = self._secrets.lens, self._secrets.focal
        k1, k2 = plane.radial * (focal / plane.unit) ** np.array([2, 4])
        return Lens(
            *self.size,
            focal_px=np.array([focal, focal]),
            focal_deviation_px=np.zeros(2),
            centre_px=plane.centre_px,
            centre_deviation_px=np.zeros(2),
            distortion=np.array([k1, k2, 0.0, 0.0, 0.0]),
            distortion_deviation=np.zeros(5),
            rms_px=0.0,
            rms_interval_px=(0.0, 0.0),
        )

    def render(self, positions: FloatArray, springs: IntArray, marked: IntArray) -> Image:
        """One frame, BGR: masses at `positions` (M, 2) [m], strips between `springs` (S, 2), markers
        m1, m2, ... on the masses `marked` (at most five)."""
        require_value("marked", len(marked) <= len(PALETTE), f"at most {len(PALETTE)} marks", len(marked))
        picture = self._developed.copy()
        box = self._box(positions)
        if box is not None:
            x0, y0, x1, y1 = box
            albedo = self._empty[y0:y1, x0:x1].copy()
            self._paint_body(albedo, (x0, y0), positions, springs)
            for name, mass in zip(PALETTE, marked, strict=False):
                self._paint_marker(albedo, (x0, y0), positions[mass], name)
            albedo = cv2.GaussianBlur(albedo, (0, 0), self._secrets.blur)
            picture[y0:y1, x0:x1] = self._develop(albedo, self._secrets.light[y0:y1, x0:x1])
        dx, dy = (int(self._rng.integers(0, n + 1)) for n in self.size)
        grain = self._grain[dy : dy + self.size[1], dx : dx + self.size[0]]
        return cv2.add(picture, grain, dtype=cv2.CV_8U)

    def _develop(self, albedo: _Picture, light: _Picture) -> _Picture:
        return 255 * cv2.pow(np.clip(albedo * light, 0, 1), self._secrets.tone)

    def _box(self, positions: FloatArray) -> tuple[int, int, int, int] | None:
        """Box of pixels that the body can cover, from (x0, y0) to before (x1, y1)."""
        pixels = self._secrets.lens.to_pixels(positions)
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        if not len(pixels):
            return None
        margin = 4 + max(1.5 * HEXAGON, 0.6 * self._marker.width) * self._secrets.lens.pixels_per_metre(
            positions.mean(axis=0)
        )
        x0, y0 = np.maximum(np.floor(pixels.min(axis=0) - margin), 0).astype(int)
        x1, y1 = np.minimum(np.ceil(pixels.max(axis=0) + margin) + 1, self.size).astype(int)
        return None if x0 >= x1 or y0 >= y1 else (x0, y0, x1, y1)

    def _paint_body(
        self, albedo: _Picture, origin: tuple[int, int], positions: FloatArray, springs: IntArray
    ) -> None:
        along = positions[springs[:, 1]] - positions[springs[:, 0]]
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        across *= STRIP / 2 / np.linalg.norm(along, axis=1, keepdims=True)
        a, b = positions[springs[:, 0]], positions[springs[:, 1]]
        strips = np.stack([a + across, b + across, b - across, a - across], axis=1)
        angles = np.pi / 3 * np.arange(6)
        hexagons = positions[:, None] + HEXAGON * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        for shapes, grey in ((strips, 0.65), (hexagons, 0.78)):
            cover = self._coverage(shapes, origin, albedo.shape[:2])[..., None]
            albedo += cover * (np.float32(grey) - albedo)

    def _coverage(self, shapes: FloatArray, origin: tuple[int, int], shape: tuple[int, int]) -> _Picture:
        """Part of each pixel that polygons (N, corners, 2) [m] cover, shape (h, w)."""
        fine = np.zeros((shape[0] * _FINE, shape[1] * _FINE), np.uint8)
        pixels = (self._secrets.lens.to_pixels(shapes) - origin + 0.5) * _FINE - 0.5
        for polygon in np.round(pixels * 16).astype(np.int32):
            cv2.fillConvexPoly(fine, polygon, 255, shift=4)
        small = cv2.resize(fine, shape[::-1], interpolation=cv2.INTER_AREA)
        return small.astype(np.float32) / 255

    def _paint_marker(self, albedo: _Picture, origin: tuple[int, int], centre: FloatArray, name: str) -> None:
        """The marker as the lens projects it, by mapping subpixels back to the plane."""
        lens = self._secrets.lens
        scale = float(lens.pixels_per_metre(centre))
        reach = int(np.ceil(0.6 * self._marker.width * scale)) + 2
        x, y = np.round(lens.to_pixels(centre)).astype(int)
        x0, y0 = max(x - reach, origin[0]), max(y - reach, origin[1])
        x1 = min(x + reach + 1, origin[0] + albedo.shape[1])
        y1 = min(y + reach + 1, origin[1] + albedo.shape[0])
        if x0 >= x1 or y0 >= y1:
            return
        points = self._subpixels(x0, y0, x1, y1) - centre
        cover, colour = self._marker.paint(name, points, 1 / (scale * _FINE))
        colour = np.clip(colour, 0.02, 1) * self._secrets.inks[name]
        part = albedo[y0 - origin[1] : y1 - origin[1], x0 - origin[0] : x1 - origin[0]]
        part *= 1 - cover.mean(axis=2)[..., None]
        part += (cover[..., None] * colour).mean(axis=2)

    def _subpixels(self, x0: int, y0: int, x1: int, y1: int) -> FloatArray:
        """Centres of the subpixels of a box in the plane [m], shape (h, w, _FINE**2, 2)."""
        steps = (np.arange(_FINE) + 0.5) / _FINE - 0.5
        dx, dy = (d.ravel() for d in np.meshgrid(steps, steps))
        points = np.empty((y1 - y0, x1 - x0, _FINE**2, 2))
        for d in range(2):  # an axis of two as the innermost takes several times as long
            at, right, down = (a[y0:y1, x0:x1, None, d] for a in (self._at, self._right, self._down))
            points[..., d] = at + dx * right + dy * down
        return points

    def _paint_background(self) -> _Picture:
        """Wall, table edge, and paper with a tag each: linear reflectance, shape (H, W, 3)."""
        size = np.abs(self._down[..., 1])
        into_table = (0.005 - np.abs(self._at[..., 1] + 0.005)) / size
        grey = 0.42 + (0.06 - 0.42) * np.clip(0.5 + into_table, 0, 1)
        for (x0, y0, x1, y1), centre, pattern in self._sheets():
            points = self._subpixels(x0, y0, x1, y1) - centre
            footprint = size[y0:y1, x0:x1, None] / _FINE
            side = self.board.side_m
            cover, tag = paint_square(pattern, side, _PAPER_BORDER * side, points, footprint)
            behind = grey[y0:y1, x0:x1, None]
            grey[y0:y1, x0:x1] = (behind + cover * (tag[..., 0] - behind)).mean(axis=2)
        warm = np.array([0.97, 1.0, 1.01])
        return (grey[..., None] * warm).astype(np.float32)

    def _sheets(self) -> list[tuple[tuple[int, int, int, int], FloatArray, Image]]:
        """For each tag: the pixels around it, its centre [m], and its squares (n, n) of 0 and 255."""
        sheets = []
        for number, centre in zip(self.board.ids, self.board.centres, strict=True):
            pattern = square_cells(self.board.dictionary, number)
            reach = 0.8 * self.board.side_m * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
            pixels = self._secrets.lens.to_pixels(centre + reach)
            x0, y0 = np.maximum(pixels.min(axis=0) - 2, 0).astype(int)
            x1, y1 = np.minimum(pixels.max(axis=0) + 3, self.size).astype(int)
            sheets.append(((x0, y0, x1, y1), centre, pattern))
        return sheets


def _pose(rng: np.random.Generator, board: TagBoard, size: tuple[int, int]) -> tuple[float, Plane]:
    """Focal length [px] and plane of a tilted camera with slight lens distortion, as near as it can be with
    every tag in view."""
    width, height = size
    focal = width * rng.uniform(1.2, 1.5)
    angles = np.radians(rng.uniform([-4, -4, -1.5], [4, 4, 1.5]))
    rotation, _ = cv2.Rodrigues(angles)
    view = rotation @ np.diag([1.0, -1.0, -1.0])  # y up in the plane is y down in a picture
    k1, k2 = rng.uniform(-0.10, 0.03), rng.uniform(-0.01, 0.01)
    centre = np.array([width - 1, height - 1]) / 2 + rng.normal(0, 3, 2)
    corners = board.corners.reshape(-1, 2)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    unit = float(np.hypot(*size)) / 2
    k = np.array([k1 * (unit / focal) ** 2, k2 * (unit / focal) ** 4])
    distance = 0.5
    while True:
        shift = np.array([0, 0, distance]) - view @ np.append(middle, 0)
        homography = np.diag([focal / unit, focal / unit, 1.0]) @ np.column_stack([view[:, :2], shift])
        lens = Plane(*size, homography, centre, k, 0.0)
        pixels = lens.to_pixels(corners)
        if ((pixels > 14) & (pixels < np.array(size) - 15)).all():
            return focal, lens
        distance *= 1.01


def _light(rng: np.random.Generator, size: tuple[int, int]) -> _Picture:
    """A lamp to one side, vignetting, and a colour cast, shape (H, W, 3)."""
    x, y = np.meshgrid(np.linspace(-1, 1, size[0]), np.linspace(-0.75, 0.75, size[1]))
    angle, fall = rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.25)
    level = 1 + fall * (x * np.cos(angle) + y * np.sin(angle)) - rng.uniform(0.05, 0.15) * (x**2 + y**2)
    cast = rng.uniform([0.85, 0.95, 0.9], [1.0, 1.0, 1.05])
    exposure = rng.uniform(0.7, 0.85)
    return (exposure * level[..., None] * cast).astype(np.float32)

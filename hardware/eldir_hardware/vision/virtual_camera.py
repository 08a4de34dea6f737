"""A virtual camera: the pictures of a robot, in its plane of motion or out of it, by a webcam on a tripod.

Lens, pose, light, exposure, ink and noise are samples of a seed; the trackers do not read them. Not modelled:
motion blur, rolling shutter, specular light and shade, focus that varies; the thickness of a robot that
stays in its plane.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eldir.core.arguments import require_value
from eldir.core.records import FloatArray, IntArray
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import FieldOfView, Image, Plane, TagBoard
from eldir_hardware.camera.projection import DiscPoses, Projection
from eldir_hardware.markers.registration import DEFAULT_KIND, PALETTE, load_kind
from eldir_hardware.markers.squares import paint_square, square_cells
from eldir_hardware.vision.solid_robot import RobotShape, bounding_box, marker_surface, paint_solids

_Picture = NDArray[Any]  # float32

HUB_RADIUS = 0.00693
"""Circumscribed radius of a mass as printed [m]."""
STRIP_THICKNESS = 0.001
"""Thickness of a strip as printed [m]."""
_TABLE_EDGE = -0.005  # height of the middle of its line [m]
_RESIN = 0.2  # reflectance of a printed ground
_SUBPIXELS = 4
"""Subpixels along a pixel's side; discs have soft edges within these, so their centres are exact."""
_PAPER_BORDER = 0.22
"""By how much the paper of a reference tag is wider than the tag, on each side [sides]."""


@dataclass(frozen=True)
class _Optics:
    """Properties of the camera that the tracker does not know."""

    focal: float  # [px]
    plane: Plane  # exact here; `calibrate_plane` has to find it again
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
        marker: str = DEFAULT_KIND,
    ):
        """`rate` in frames a second; `noise` is the sensor's, a standard deviation in grey levels; `marker`:
        the kind of marker on the masses."""
        self.marker_kind = load_kind(marker)
        """Kind of the markers on the masses."""
        self.board = board or TagBoard.around(workspace)
        self.size = size
        self.rate = rate
        rng = np.random.default_rng([seed, 0xCA3E7A])
        self._rng = np.random.default_rng([seed, 1])
        focal, plane = sample_pose(rng, self.board, size)
        self._optics = _Optics(
            focal,
            plane,
            _sample_light(rng, size),
            {name: rng.uniform(0.85, 1.1, 3).astype(np.float32) for name in PALETTE},
            tone=1 / rng.uniform(1.7, 2.2),
            blur=rng.uniform(0.7, 0.9),
        )
        columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
        self.pixel_positions = plane.to_metres(np.stack([columns, rows], axis=-1))
        """Position of each pixel in the plane of motion [m], shape (H, W, 2)."""
        self._right = np.gradient(self.pixel_positions, axis=1)
        self._down = np.gradient(self.pixel_positions, axis=0)
        self._view, self._shape = Projection.of(plane, focal), RobotShape()
        self.background = self._paint_background()
        # Twice as wide and high as a frame; every frame takes another window of it.
        self._grain = rng.normal(0.0, noise, (2 * size[1], 2 * size[0], 3)).astype(np.float32)

    @property
    def background(self) -> _Picture:
        """Linear reflectance without the robot, BGR, shape (H, W, 3): wall, table, reference tags, and what a
        program paints over them."""
        return self._background

    @background.setter
    def background(self, reflectance: _Picture) -> None:
        self._background = reflectance
        blurred = cv2.GaussianBlur(reflectance, (0, 0), self._optics.blur)
        self._developed = self._develop(blurred, self._optics.light)

    @property
    def plane(self) -> Plane:
        """The exact plane of motion; a tracker has to calibrate it from the pictures."""
        return self._optics.plane

    @property
    def lens(self) -> Lens:
        """The lens that an exact calibration of this camera would give; the tracker does not get it."""
        plane, focal = self._optics.plane, self._optics.focal
        k1, k2 = plane.radial * (focal / plane.half_diagonal_px) ** np.array([2, 4])
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

    def paint_ground(self, surface: FloatArray) -> None:
        """Paint a printed ground behind the robot, from the table up to a surface with corners x and height
        [m], shape (K, 2)."""
        x, y = np.moveaxis(self.pixel_positions, 2, 0)
        height = np.interp(x, surface[:, 0], surface[:, 1], left=-np.inf, right=-np.inf)
        background = self.background.copy()
        background[(y > _TABLE_EDGE) & (y < height)] = _RESIN
        self.background = background

    def render(self, positions: FloatArray, springs: IntArray, marked: IntArray) -> Image:
        """One frame, BGR: masses at `positions` (M, 2) [m], strips between `springs` (S, 2), markers
        m1, m2, ... on the masses `marked` (at most five)."""
        require_value("marked", len(marked) <= len(PALETTE), f"at most {len(PALETTE)} markers", len(marked))

        def paint(albedo: _Picture, origin: tuple[int, int]) -> None:
            self.paint_body(albedo, origin, positions, springs)
            for name, mass in zip(PALETTE, marked, strict=False):
                self.paint_marker(albedo, origin, positions[mass], name)

        reach = max(1.5 * HUB_RADIUS, 0.6 * self.marker_kind.width)
        return self._expose(
            self._bounding_box(self._optics.plane.to_pixels(positions), positions, reach), paint
        )

    def render_solid(self, discs: DiscPoses, springs: IntArray, marked: IntArray) -> Image:
        """One frame, BGR, of a robot with two faces that may have left the plane of motion; `springs` and
        `marked` as of `render`. Markers are on the front discs."""
        require_value("marked", len(marked) <= len(PALETTE), f"at most {len(PALETTE)} markers", len(marked))
        solids = self._shape.solids(discs, springs)
        surfaces = [marker_surface(self._view, discs, mass) for mass in marked.tolist()]

        def paint(albedo: _Picture, origin: tuple[int, int]) -> None:
            paint_solids(albedo, origin, self._view, solids, _SUBPIXELS)
            for name, surface in zip(PALETTE, surfaces, strict=False):
                if surface is not None:
                    self._paint_marker_on(albedo, origin, surface, name)

        pixels = self._view.to_pixels(np.concatenate(solids.corners))
        front = discs.outsides[:, 0, [0, 2]]
        return self._expose(self._bounding_box(pixels, front, 0.6 * self.marker_kind.width), paint)

    def _bounding_box(
        self, pixels: FloatArray, positions: FloatArray, reach: float
    ) -> tuple[int, int, int, int] | None:
        """Box around the pixels (N, 2) of a body at `positions` (M, 2), and what reaches farther [m]."""
        if not len(positions):
            return None
        scale = float(self._optics.plane.pixels_per_metre(positions.mean(axis=0)))
        return bounding_box(pixels, 4 + reach * scale, self.size)

    def _expose(
        self,
        box: tuple[int, int, int, int] | None,
        paint: Callable[[_Picture, tuple[int, int]], None],
    ) -> Image:
        """The picture, with what `paint` paints into the reflectance of a box from (x0, y0) to before
        (x1, y1)."""
        picture = self._developed.copy()
        if box is not None:
            x0, y0, x1, y1 = box
            albedo = self._background[y0:y1, x0:x1].copy()
            paint(albedo, (x0, y0))
            albedo = cv2.GaussianBlur(albedo, (0, 0), self._optics.blur)
            picture[y0:y1, x0:x1] = self._develop(albedo, self._optics.light[y0:y1, x0:x1])
        dx, dy = (int(self._rng.integers(0, n + 1)) for n in self.size)
        grain = self._grain[dy : dy + self.size[1], dx : dx + self.size[0]]
        return cv2.add(picture, grain, dtype=cv2.CV_8U)

    def _develop(self, albedo: _Picture, light: _Picture) -> _Picture:
        return 255 * cv2.pow(np.clip(albedo * light, 0, 1), self._optics.tone)

    def paint_body(
        self, albedo: _Picture, origin: tuple[int, int], positions: FloatArray, springs: IntArray
    ) -> None:
        """Paint strips and hubs of a body into a reflectance (h, w, 3) whose first pixel is `origin`."""
        along = positions[springs[:, 1]] - positions[springs[:, 0]]
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        across *= STRIP_THICKNESS / 2 / np.linalg.norm(along, axis=1, keepdims=True)
        a, b = positions[springs[:, 0]], positions[springs[:, 1]]
        strips = np.stack([a + across, b + across, b - across, a - across], axis=1)
        angles = np.pi / 3 * np.arange(6)
        hexagons = positions[:, None] + HUB_RADIUS * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        for shapes, grey in ((strips, 0.65), (hexagons, 0.78)):
            cover = self.coverage(shapes, origin, albedo.shape[:2])[..., None]
            albedo += cover * (np.float32(grey) - albedo)

    def coverage(self, shapes: FloatArray, origin: tuple[int, int], shape: tuple[int, int]) -> _Picture:
        """Part of each pixel that polygons (N, corners, 2) [m] cover, shape (h, w)."""
        fine = np.zeros((shape[0] * _SUBPIXELS, shape[1] * _SUBPIXELS), np.uint8)
        pixels = (self._optics.plane.to_pixels(shapes) - origin + 0.5) * _SUBPIXELS - 0.5
        for polygon in np.round(pixels * 16).astype(np.int32):
            cv2.fillConvexPoly(fine, polygon, 255, shift=4)
        small = cv2.resize(fine, shape[::-1], interpolation=cv2.INTER_AREA)
        return small.astype(np.float32) / 255

    def paint_marker(self, albedo: _Picture, origin: tuple[int, int], centre: FloatArray, name: str) -> None:
        """Paint a marker at `centre` (2,) [m] into a reflectance (h, w, 3) whose first pixel is `origin`."""
        plane = self._optics.plane
        scale = float(plane.pixels_per_metre(centre))
        reach = int(np.ceil(0.6 * self.marker_kind.width * scale)) + 2
        x, y = np.round(plane.to_pixels(centre)).astype(int)
        x0, y0 = max(x - reach, origin[0]), max(y - reach, origin[1])
        x1 = min(x + reach + 1, origin[0] + albedo.shape[1])
        y1 = min(y + reach + 1, origin[1] + albedo.shape[0])
        if x0 >= x1 or y0 >= y1:
            return
        points = self._subpixels(x0, y0, x1, y1) - centre
        self._blend_marker(albedo, origin, (x0, y0), points, name, 1 / (scale * _SUBPIXELS))

    def _paint_marker_on(self, albedo: _Picture, origin: tuple[int, int], surface: Plane, name: str) -> None:
        """Paint a marker around the origin of a flat surface."""
        half = 0.6 * self.marker_kind.width
        corners = surface.to_pixels(half * np.array([[-1.0, -1], [-1, 1], [1, -1], [1, 1]]))
        size = origin[0] + albedo.shape[1], origin[1] + albedo.shape[0]
        box = bounding_box(corners, 2, size)
        if box is None:
            return
        x0, y0 = max(box[0], origin[0]), max(box[1], origin[1])
        x1, y1 = box[2:]
        if x1 - x0 < 2 or y1 - y0 < 2:
            return
        pixels = np.stack(np.meshgrid(np.arange(x0, x1), np.arange(y0, y1)), axis=-1).astype(np.float64)
        at = surface.to_metres(pixels)
        points = _spread(at, np.gradient(at, axis=1), np.gradient(at, axis=0))
        scale = float(surface.pixels_per_metre(np.zeros(2)))
        self._blend_marker(albedo, origin, (x0, y0), points, name, 1 / (scale * _SUBPIXELS))

    def _blend_marker(
        self,
        albedo: _Picture,
        origin: tuple[int, int],
        corner: tuple[int, int],
        points: FloatArray,
        name: str,
        width: float,
    ) -> None:
        """Blend a marker into the box of pixels that begins at `corner` and whose subpixels are at `points`
        (h, w, _SUBPIXELS**2, 2) from the marker's centre [m], each as wide as `width` [m]."""
        cover, colour = self.marker_kind.paint(name, points, width)
        colour = np.clip(colour, 0.02, 1) * self._optics.inks[name]
        x, y = corner[0] - origin[0], corner[1] - origin[1]
        part = albedo[y : y + len(points), x : x + points.shape[1]]
        part *= 1 - cover.mean(axis=2)[..., None]
        part += (cover[..., None] * colour).mean(axis=2)

    def _subpixels(self, x0: int, y0: int, x1: int, y1: int) -> FloatArray:
        """Centres of the subpixels of a box in the plane [m], shape (h, w, _SUBPIXELS**2, 2)."""
        return _spread(*(a[y0:y1, x0:x1] for a in (self.pixel_positions, self._right, self._down)))

    def _paint_background(self) -> _Picture:
        """Wall, table edge, and paper with a tag each: linear reflectance, shape (H, W, 3)."""
        size = np.abs(self._down[..., 1])
        into_table = (0.005 - np.abs(self.pixel_positions[..., 1] + 0.005)) / size
        grey = 0.42 + (0.06 - 0.42) * np.clip(0.5 + into_table, 0, 1)
        for (x0, y0, x1, y1), centre, pattern in self._sheets():
            points = self._subpixels(x0, y0, x1, y1) - centre
            footprint = size[y0:y1, x0:x1, None] / _SUBPIXELS
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
            pixels = self._optics.plane.to_pixels(centre + reach)
            x0, y0 = np.maximum(pixels.min(axis=0) - 2, 0).astype(int)
            x1, y1 = np.minimum(pixels.max(axis=0) + 3, self.size).astype(int)
            sheets.append(((x0, y0, x1, y1), centre, pattern))
        return sheets


def _spread(at: FloatArray, right: FloatArray, down: FloatArray) -> FloatArray:
    """Places of the subpixels of pixels at `at` (h, w, 2), with the steps to the next pixels to the right and
    down (h, w, 2): shape (h, w, _SUBPIXELS**2, 2)."""
    steps = (np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5
    dx, dy = (d.ravel() for d in np.meshgrid(steps, steps))
    points = np.empty((*at.shape[:2], _SUBPIXELS**2, 2))
    for d in range(2):  # an axis of two as the innermost takes several times as long
        points[..., d] = at[..., None, d] + dx * right[..., None, d] + dy * down[..., None, d]
    return points


def sample_pose(rng: np.random.Generator, board: TagBoard, size: tuple[int, int]) -> tuple[float, Plane]:
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
        plane = Plane(*size, homography, centre, k, 0.0)
        pixels = plane.to_pixels(corners)
        if ((pixels > 14) & (pixels < np.array(size) - 15)).all():
            return focal, plane
        distance *= 1.01


def _sample_light(rng: np.random.Generator, size: tuple[int, int]) -> _Picture:
    """A lamp to one side, vignetting, and a colour cast, shape (H, W, 3)."""
    x, y = np.meshgrid(np.linspace(-1, 1, size[0]), np.linspace(-0.75, 0.75, size[1]))
    angle, fall = rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.25)
    level = 1 + fall * (x * np.cos(angle) + y * np.sin(angle)) - rng.uniform(0.05, 0.15) * (x**2 + y**2)
    cast = rng.uniform([0.85, 0.95, 0.9], [1.0, 1.0, 1.05])
    exposure = rng.uniform(0.7, 0.85)
    return (exposure * level[..., None] * cast).astype(np.float32)

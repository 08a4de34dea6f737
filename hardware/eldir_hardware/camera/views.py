"""Views of a calibration pattern: the ChArUco sheet to print, and corners found in pictures of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from io import BytesIO

import cv2
import numpy as np

from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir_hardware.camera.lens import ROTATED_HINT
from eldir_hardware.camera.plane import Image

_MIN_CORNERS = 8
_REFINEMENT_WINDOWS = (0.18, 0.35)
"""Half sides of the windows in which a chessboard's corners are located again [distances of two corners].
In photographs, the error grows from 0.4 on."""
_MIN_WINDOW = 3
"""Least half side of such a window [px]."""
_MIN_SHIFT = 0.02
"""A view whose corners all lie closer to those of an earlier view is a duplicate [part of the width]."""


@dataclass(frozen=True)
class Pattern:
    """The printed pattern: a ChArUco sheet counted by squares, or a `chessboard` counted by inner corners."""

    columns: int = 10
    rows: int = 7
    square: float = 0.025
    """Side of a square [m]."""
    chessboard: bool = False

    @property
    def board(self) -> cv2.aruco.CharucoBoard:
        """ChArUco of 10 x 7 squares, markers three quarters as large."""
        tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, 0.75 * self.square, tags)


@dataclass(frozen=True)
class View:
    """The pattern's corners in one picture."""

    name: str
    points: FloatArray
    """Corners on the pattern [m], shape (N, 3), z = 0."""
    pixels: FloatArray
    """Corners in the picture [px], shape (N, 2)."""
    alternatives: tuple[FloatArray, ...] = ()
    """The same corners by other methods of detection [px], each of shape (N, 2)."""

    def with_corners_by(self, method: int) -> View:
        """This view with the corners of one method: 0 for `pixels`, then the alternatives."""
        return replace(self, pixels=(self.pixels, *self.alternatives)[method])


@dataclass(frozen=True)
class Views:
    """Views found in pictures of one camera."""

    size: tuple[int, int]
    views: list[View]
    without_pattern: list[str]
    """Pictures that do not show the pattern."""
    duplicates: int
    """Number of pictures without a new view: the pattern has the same place as in another one."""


def pattern_sheet(pattern: Pattern) -> bytes:
    """The sheet as PDF, A4 across, in its true size."""
    from matplotlib.figure import Figure

    paper, inch = np.array([0.297, 0.210]), 0.0254
    image = pattern.board.generateImage((pattern.columns * 80, pattern.rows * 80), marginSize=0)
    size = np.array([pattern.columns, pattern.rows]) * pattern.square / paper
    figure = Figure(figsize=tuple(paper / inch))
    axes = figure.add_axes((*((1 - size) / 2), *size))
    axes.imshow(image, cmap="gray", interpolation="none")
    axes.set_axis_off()
    text = f"print at 100 %: ten squares are {1e4 * pattern.square:.0f} mm; glue onto something flat"
    figure.text(0.5, 0.02, text, ha="center", fontsize=9)
    buffer = BytesIO()
    figure.savefig(buffer, format="pdf", metadata={"CreationDate": None})
    return buffer.getvalue()


def find_views(pictures: Iterable[tuple[str, Image]], pattern: Pattern) -> Views:
    """Corners in every picture with enough of them, without duplicates of earlier views. Raises `InputError`
    where pictures differ in size, and without pictures."""
    found: list[View] = []
    without_pattern: list[str] = []
    size: tuple[int, int] | None = None
    duplicates = 0
    for name, image in pictures:
        current = (image.shape[1], image.shape[0])
        if size is not None and current != size:
            raise InputError(
                "the pictures differ in size",
                code="camera.sizes-differ",
                expected=f"{size[0]} x {size[1]} pixels as the first",
                found=f"{current[0]} x {current[1]} in {name}{ROTATED_HINT if current == size[::-1] else ''}",
                remedy="calibrate with pictures of one camera at one size",
            )
        size = current
        view = _detect_corners(name, image, pattern)
        if view is None:
            without_pattern.append(name)
        elif any(_max_corner_shift(view, other) < _MIN_SHIFT * current[0] for other in found):
            duplicates += 1
        else:
            found.append(view)
    if size is None:
        raise InputError(
            "no picture to calibrate the camera from",
            code="camera.no-picture",
            expected="at least 10",
            found="0",
        )
    return Views(size, found, without_pattern, duplicates)


def _detect_corners(name: str, image: Image, pattern: Pattern) -> View | None:
    grey: Image = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    if pattern.chessboard:
        shape = (pattern.columns, pattern.rows)
        good, corners = cv2.findChessboardCornersSB(grey, shape, flags=cv2.CALIB_CB_ACCURACY)
        if not good:
            return None
        x, y = np.meshgrid(np.arange(pattern.columns), np.arange(pattern.rows))
        points = pattern.square * np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
        pixels = corners.reshape(-1, 2).astype(np.float64)
        return View(
            name, points, pixels, tuple(_refine_corners(grey, pixels, part) for part in _REFINEMENT_WINDOWS)
        )
    board = pattern.board
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
    if ids is None or len(ids) < _MIN_CORNERS:
        return None
    points = np.asarray(board.getChessboardCorners(), np.float64)[ids.ravel()]
    if np.linalg.matrix_rank(points[:, :2] - points[:, :2].mean(axis=0)) < 2:
        return None  # all on one line
    return View(name, points, corners.reshape(-1, 2).astype(np.float64))


def _refine_corners(grey: Image, pixels: FloatArray, part: float) -> FloatArray:
    """Corners (N, 2) [px] refined as saddle points within windows, shape (N, 2) [px].

    Half a window's side is a `part` of the least distance between two corners.
    """
    distances = np.linalg.norm(pixels[:, None] - pixels, axis=-1)
    side = max(int(part * distances[distances > 0].min()), _MIN_WINDOW)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    start = pixels.astype(np.float32).reshape(-1, 1, 2).copy()
    return cv2.cornerSubPix(grey, start, (side, side), (-1, -1), stop).reshape(-1, 2).astype(np.float64)


def _max_corner_shift(a: View, b: View) -> float:
    """Greatest distance between the positions of a corner that both views show [px]."""
    positions = {tuple(p): q for p, q in zip(a.points.tolist(), a.pixels, strict=True)}
    both = [
        (positions[tuple(p)], q)
        for p, q in zip(b.points.tolist(), b.pixels, strict=True)
        if tuple(p) in positions
    ]
    if not both:
        return float("inf")
    return float(np.max([np.hypot(*(p - q)) for p, q in both]))

"""Fits a lens to views of a pattern; the error names what is missing if the views do not determine it."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from eldir.core.records import FloatArray, IntArray
from eldir.errors import InputError
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import Image
from eldir_hardware.camera.validity import LENS_DAYS, valid_for
from eldir_hardware.camera.views import View, Views

_logger = logging.getLogger(__name__)

_LEAST_VIEWS = 10
_LEAST_TILT = 15.0  # [degrees]
_LEAST_TILTED = 3
_WORST_RMS = 1.0  # [px]
_WORST_FOCAL = 0.01
"""Greatest standard deviation of the focal length, relative."""
_OUTLIER = 3.0
"""A view whose error is larger than the median by this factor is left out: it is blurred or bent."""
_BETTER = 0.95
"""The third radial term stays zero unless it lowers the error to this part."""
_PLACES = [f"{y} {x}".strip() for y in ("top", "", "bottom") for x in ("left", "middle", "right")]


@dataclass(frozen=True)
class Calibration:
    """A lens and the views that it was fitted to."""

    lens: Lens
    views: list[View]
    errors: FloatArray
    """RMS of each view [px]."""
    left_out: list[str]
    """Names of views much worse than the others."""


def calibrate_lens(found: Views, provenance: dict[str, Any] | None = None) -> Calibration:
    """Fit the lens to views of one camera. Raises `InputError` if they are too few or too similar."""
    _require_enough(found)
    views, located = _best_located(found)
    fit = _fit(views, found.size)
    _logger.info("fitted the lens to %d views: reprojection error %.2f px", len(views), fit.rms)
    errors = fit.errors
    left_out: list[str] = []
    good = errors <= _OUTLIER * np.median(errors)
    if not good.all():
        left_out = [v.name for v, g in zip(views, good, strict=True) if not g]
        views = [v for v, g in zip(views, good, strict=True) if g]
        located = [[v for v, g in zip(other, good, strict=True) if g] for other in located]
        _require_enough(Views(found.size, views, found.blind, found.alike))
        fit = _fit(views, found.size)
        _logger.info("fitted again without %s: %.2f px", ", ".join(left_out), fit.rms)
    _require_tilts(fit.tilts, len(views))
    deviation = _deviation(fit, views, [_fit(other, found.size) for other in located])
    lens = Lens(
        *found.size,
        focal_px=fit.matrix[[0, 1], [0, 1]],
        focal_deviation_px=deviation[:2],
        centre_px=fit.matrix[:2, 2],
        centre_deviation_px=deviation[2:4],
        distortion=fit.distortion,
        distortion_deviation=deviation[4:],
        rms_px=fit.rms,
        rms_interval_px=_interval(fit.errors),
        provenance={
            "views": len(views),
            "left_out": left_out,
            "corners": sum(len(v.pixels) for v in views),
            "tilt_deg": [round(float(x), 1) for x in np.hypot(*fit.tilts.T)],
            **(provenance or {}),
            **valid_for(LENS_DAYS),
        },
    )
    if fit.rms > _WORST_RMS:
        raise InputError(
            "the views do not fit one lens",
            code="camera.views-disagree",
            expected=f"a reprojection error below {_WORST_RMS:g} px",
            found=f"{fit.rms:.2f} px; the worst view is {views[int(fit.errors.argmax())].name}",
            remedy="use a flat pattern, no motion blur, fixed focus and zoom; check the number of corners",
        )
    if lens.deviation[:2].max() > _WORST_FOCAL * lens.focal_px.min():
        raise InputError(
            "the views do not determine the focal length",
            code="camera.unknown-focal-length",
            expected=f"a standard deviation below {_WORST_FOCAL:.0%}",
            found=f"{lens.deviation[:2].max() / lens.focal_px.min():.1%}",
            remedy="add views with the pattern tilted by 30 to 45 degrees, near and far",
        )
    return Calibration(lens, views, fit.errors, left_out)


_ENLARGED = 100  # errors on the map


def coverage(views: list[View], size: tuple[int, int]) -> IntArray:
    """Corners in each ninth of the picture, from the top left, row by row, shape (9,)."""
    pixels = np.concatenate([v.pixels for v in views]) if views else np.zeros((0, 2))
    cells = np.clip((pixels * 3 / np.array(size)).astype(int), 0, 2)
    return np.bincount(cells[:, 1] * 3 + cells[:, 0], minlength=9)


def coverage_map(fit: Calibration) -> bytes:
    """A picture (PNG) of where corners were seen, with their errors drawn `_ENLARGED` times larger, and the
    scale of both."""
    lens = fit.lens
    width, height = lens.size
    picture: Image = np.full((height, width, 3), 255, np.uint8)
    for k in (1, 2):
        cv2.line(picture, (k * width // 3, 0), (k * width // 3, height), (220, 220, 220), 1)
        cv2.line(picture, (0, k * height // 3), (width, k * height // 3), (220, 220, 220), 1)
    for view in fit.views:
        _, rotation, shift = cv2.solvePnP(view.points, view.pixels, lens.matrix, lens.distortion)
        there, _ = cv2.projectPoints(view.points, rotation, shift, lens.matrix, lens.distortion)
        for p, q in zip(view.pixels, there[:, 0], strict=True):
            end = p + _ENLARGED * (p - q)
            a, b = (tuple(np.round(8 * x).astype(int).tolist()) for x in (p, end))
            cv2.line(picture, a, b, (0, 94, 213), 1, cv2.LINE_AA, shift=3)
            cv2.circle(picture, a, 16, (178, 114, 0), -1, cv2.LINE_AA, shift=3)
    return cv2.imencode(".png", np.vstack([picture, _scale(width, lens.size)]))[1].tobytes()


def _scale(width: int, size: tuple[int, int]) -> Image:
    """A strip below the map: how long an error of one pixel is drawn, and the size of the picture."""
    strip: Image = np.full((40, width, 3), 255, np.uint8)
    cv2.line(strip, (10, 20), (10 + _ENLARGED, 20), (0, 94, 213), 2, cv2.LINE_AA)
    words = f"error of 1 px; dots: corners; picture {size[0]} x {size[1]} px"
    height = min(0.5, (width - _ENLARGED - 30) / 850)
    cv2.putText(
        strip, words, (20 + _ENLARGED, 25), cv2.FONT_HERSHEY_SIMPLEX, height, (0, 0, 0), 1, cv2.LINE_AA
    )
    return strip


@dataclass(frozen=True)
class _LensFit:
    rms: float
    matrix: FloatArray
    distortion: FloatArray
    deviation: FloatArray  # from the scatter of corners alone
    errors: FloatArray
    tilts: FloatArray  # of each view about the vertical and the horizontal [degrees], shape (N, 2)
    poses: list[tuple[FloatArray, FloatArray]]  # rotation vector and shift of each view
    other_model: FloatArray  # `values` of another model that fits as well, shape (9,)

    @property
    def values(self) -> FloatArray:
        """Focal length, centre and distortion, shape (9,)."""
        return np.concatenate([self.matrix[[0, 1], [0, 1]], self.matrix[:2, 2], self.distortion])


def _fit(views: list[View], size: tuple[int, int]) -> _LensFit:
    two, three = (_fit_terms(views, size, flags) for flags in (cv2.CALIB_FIX_K3, 0))
    if three.rms < _BETTER * two.rms:
        return replace(three, other_model=three.values)  # two terms are refuted
    return replace(two, other_model=three.values)


def _fit_terms(views: list[View], size: tuple[int, int], flags: int) -> _LensFit:
    points = [v.points.astype(np.float32) for v in views]
    pixels = [v.pixels.astype(np.float32) for v in views]
    start, none = np.eye(3), np.zeros(5)  # overwritten: no guess is asked for
    rms, *rest = cv2.calibrateCameraExtended(points, pixels, size, start, none, flags=flags)
    matrix, distortion, rotations, shifts, deviation, _, errors = (np.asarray(r) for r in rest)
    normals = np.array([cv2.Rodrigues(r)[0][:, 2] for r in rotations])
    normals *= np.sign(normals[:, 2:])
    tilts = np.degrees(np.arcsin(np.clip(normals[:, :2], -1, 1)))
    return _LensFit(
        float(rms),
        matrix,
        distortion.ravel()[:5],
        deviation.ravel()[:9],
        errors.ravel().astype(float),
        tilts,
        list(zip(rotations, shifts, strict=True)),
        np.zeros(9),
    )


def _best_located(found: Views) -> tuple[list[View], list[list[View]]]:
    """The views with the corners of the method that fits a lens best, and those of all methods."""
    methods = range(1 + min(len(v.alternatives) for v in found.views))
    located = [[v.located(m) for v in found.views] for m in methods]
    best = min(located, key=lambda views: _fit_terms(views, found.size, cv2.CALIB_FIX_K3).rms)
    return best, located if len(located) > 1 else []


def _deviation(fit: _LensFit, views: list[View], others: list[_LensFit]) -> FloatArray:
    """Standard deviations of focal length, centre and distortion, shape (9,).

    Corners of one view err together (a sheet that is not flat, blur), so the scatter of corners understates
    them: the views' scatter is taken where it is larger. What another model of the lens and other methods
    to locate corners change is added, because no view shows which of them is right.
    """
    scatter = np.maximum(fit.deviation, _over_views(fit, views))
    model = fit.values - fit.other_model
    methods = np.std([other.values for other in others], axis=0, ddof=1) if others else np.zeros(9)
    deviation = np.sqrt(scatter**2 + model**2 + methods**2)
    return np.where(fit.deviation > 0, deviation, 0.0)


def _over_views(fit: _LensFit, views: list[View]) -> FloatArray:
    """Standard deviations (9,) by leaving out each view in turn (jackknife), linearised at the fit.

    The poses are eliminated from the normal equations (Schur complement), so no view is fitted again.
    """
    free = fit.deviation > 0
    information, pulls = [], []
    for view, (rotation, shift) in zip(views, fit.poses, strict=True):
        there, jacobian = cv2.projectPoints(view.points, rotation, shift, fit.matrix, fit.distortion)
        residual = (view.pixels - there[:, 0]).ravel()
        pose, lens = jacobian[:, :6], jacobian[:, 6:15][:, free]
        reduced = lens - pose @ np.linalg.lstsq(pose, lens, rcond=None)[0]
        information.append(reduced.T @ reduced)
        pulls.append(reduced.T @ residual)
    total = np.sum(information, axis=0)
    n = len(views)
    moved = np.array([np.linalg.solve(total - i, p) for i, p in zip(information, pulls, strict=True)])
    deviation = np.zeros(9)
    deviation[free] = np.sqrt((n - 1) / n * ((moved - moved.mean(axis=0)) ** 2).sum(axis=0))
    return deviation


def _require_enough(found: Views) -> None:
    if len(found.views) < _LEAST_VIEWS:
        blind = f", {len(found.blind)} show no pattern (such as {found.blind[0]})" if found.blind else ""
        alike = f", {found.alike} show it at the same place as another" if found.alike else ""
        raise InputError(
            "too few views to calibrate the camera",
            code="camera.too-few-views",
            expected=f"at least {_LEAST_VIEWS} that differ",
            found=f"{len(found.views)}{blind}{alike}",
            remedy="add views: in every corner, tilted, near; a chessboard needs --chessboard",
        )
    cells = coverage(found.views, found.size)
    empty = [name for name, n in zip(_PLACES, cells, strict=True) if n == 0]
    if empty:
        raise InputError(
            "the views do not cover the whole picture",
            code="camera.views-at-places",
            expected="corners in every ninth of the picture",
            found=f"none at the {', '.join(empty)}",
            remedy="add views with the pattern there",
        )


def _require_tilts(tilts: FloatArray, count: int) -> None:
    steep = np.abs(tilts) > _LEAST_TILT
    for axis, name in ((0, "left or right"), (1, "up or down")):
        if steep[:, axis].sum() < _LEAST_TILTED:
            raise InputError(
                "the views are too similar",
                code="camera.views-alike",
                expected=f"{_LEAST_TILTED} with the pattern turned {name} by {_LEAST_TILT:.0f} degrees",
                found=f"{steep[:, axis].sum()} of {count}",
                remedy=f"add views with the pattern turned {name} by 30 to 45 degrees",
            )


def _interval(errors: FloatArray) -> tuple[float, float]:
    """95 % interval of the RMS error over views, by bootstrap."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(errors), (2000, len(errors)))
    low, high = np.percentile(np.sqrt((errors[drawn] ** 2).mean(axis=1)), [2.5, 97.5])
    return float(low), float(high)

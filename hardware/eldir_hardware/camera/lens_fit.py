"""Fits a lens to views of a pattern, with the standard deviations of its parameters."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import cv2
import numpy as np

from eldir.core.records import FloatArray, IntArray
from eldir.errors import InputError
from eldir_hardware.camera.lens import LENS_VALIDITY_DAYS, Lens, validity_period
from eldir_hardware.camera.plane import Image
from eldir_hardware.camera.views import View, Views

_logger = logging.getLogger(__name__)

_MIN_VIEWS = 10
_MIN_TILT = 15.0  # [degrees]
_MIN_TILTED_VIEWS = 3
_MAX_RMS = 1.0  # [px]
_MAX_FOCAL_DEVIATION = 0.01
"""Greatest standard deviation of the focal length, relative."""
_OUTLIER_FACTOR = 3.0
"""A view whose error is larger than the median by this factor is an outlier: it is blurred or bent."""
_K3_ERROR_RATIO = 0.95
"""The third radial term k3 stays zero unless it lowers the error to this part."""
_CELL_NAMES = [f"{y} {x}".strip() for y in ("top", "", "bottom") for x in ("left", "middle", "right")]
_ERROR_MAGNIFICATION = 100  # errors on the map


@dataclass(frozen=True)
class LensCalibration:
    """A lens and the views that it was fitted to."""

    lens: Lens
    views: list[View]
    errors: FloatArray
    """RMS of each view [px]."""
    outliers: list[str]
    """Names of the views that were left out for their large errors."""


def calibrate_lens(detected: Views, provenance: dict[str, Any] | None = None) -> LensCalibration:
    """Fit the lens to views of one camera. Raises `InputError` if they are too few or too similar."""
    _require_enough(detected)
    views, views_by_method = _best_corner_method(detected)
    fit = _fit_lens(views, detected.size)
    _logger.info("fitted the lens to %d views: reprojection error %.2f px", len(views), fit.rms)
    good = fit.errors <= _OUTLIER_FACTOR * np.median(fit.errors)
    outliers = [v.name for v, g in zip(views, good, strict=True) if not g]
    if outliers:
        views = list(compress(views, good))
        views_by_method = [list(compress(other, good)) for other in views_by_method]
        _require_enough(replace(detected, views=views))
        fit = _fit_lens(views, detected.size)
        _logger.info("fitted again without %s: %.2f px", ", ".join(outliers), fit.rms)
    _require_tilts(fit.tilts, len(views))
    deviations = _standard_deviations(fit, views, [_fit_lens(v, detected.size) for v in views_by_method])
    origin = _provenance(fit, views, outliers) | (provenance or {}) | validity_period(LENS_VALIDITY_DAYS)
    lens = _to_lens(fit, deviations, detected.size, origin)
    _require_accurate(lens, views[int(fit.errors.argmax())].name)
    return LensCalibration(lens, views, fit.errors, outliers)


def _provenance(fit: _LensFit, views: list[View], outliers: list[str]) -> dict[str, Any]:
    return {
        "views": len(views),
        "left_out": outliers,
        "corners": sum(len(v.pixels) for v in views),
        "tilt_deg": [round(float(x), 1) for x in np.hypot(*fit.tilts.T)],
    }


def _to_lens(
    fit: _LensFit, deviations: FloatArray, size: tuple[int, int], provenance: dict[str, Any]
) -> Lens:
    return Lens(
        *size,
        focal_px=fit.matrix[[0, 1], [0, 1]],
        focal_deviation_px=deviations[:2],
        centre_px=fit.matrix[:2, 2],
        centre_deviation_px=deviations[2:4],
        distortion=fit.distortion,
        distortion_deviation=deviations[4:],
        rms_px=fit.rms,
        rms_interval_px=_bootstrap_interval(fit.errors),
        provenance=provenance,
    )


def _require_accurate(lens: Lens, worst_view: str) -> None:
    """Raise `InputError` for a large reprojection error, and for an uncertain focal length."""
    if lens.rms_px > _MAX_RMS:
        raise InputError(
            "the views do not fit one lens",
            code="camera.views-disagree",
            expected=f"a reprojection error below {_MAX_RMS:g} px",
            found=f"{lens.rms_px:.2f} px; the worst view is {worst_view}",
            remedy="use a flat pattern, no motion blur, fixed focus and zoom; check the number of corners",
        )
    relative = lens.focal_deviation_px.max() / lens.focal_px.min()
    if relative > _MAX_FOCAL_DEVIATION:
        raise InputError(
            "the views do not determine the focal length",
            code="camera.unknown-focal-length",
            expected=f"a standard deviation below {_MAX_FOCAL_DEVIATION:.0%}",
            found=f"{relative:.1%}",
            remedy="add views with the pattern tilted by 30 to 45 degrees, near and far",
        )


def coverage(views: list[View], size: tuple[int, int]) -> IntArray:
    """Corners in each ninth of the picture, from the top left, row by row, shape (9,)."""
    pixels = np.concatenate([v.pixels for v in views]) if views else np.zeros((0, 2))
    cells = np.clip((pixels * 3 / np.array(size)).astype(int), 0, 2)
    return np.bincount(cells[:, 1] * 3 + cells[:, 0], minlength=9)


def coverage_map(fit: LensCalibration) -> bytes:
    """A picture (PNG) of the corners in all views, with their errors magnified."""
    lens = fit.lens
    width, height = lens.size
    picture: Image = np.full((height, width, 3), 255, np.uint8)
    for k in (1, 2):
        cv2.line(picture, (k * width // 3, 0), (k * width // 3, height), (220, 220, 220), 1)
        cv2.line(picture, (0, k * height // 3), (width, k * height // 3), (220, 220, 220), 1)
    for view in fit.views:
        _, rotation, shift = cv2.solvePnP(view.points, view.pixels, lens.matrix, lens.distortion)
        projected, _ = cv2.projectPoints(view.points, rotation, shift, lens.matrix, lens.distortion)
        for p, q in zip(view.pixels, projected[:, 0], strict=True):
            end = p + _ERROR_MAGNIFICATION * (p - q)
            a, b = (tuple(np.round(8 * x).astype(int).tolist()) for x in (p, end))
            cv2.line(picture, a, b, (0, 94, 213), 1, cv2.LINE_AA, shift=3)
            cv2.circle(picture, a, 16, (178, 114, 0), -1, cv2.LINE_AA, shift=3)
    return cv2.imencode(".png", np.vstack([picture, _map_legend(width, lens.size)]))[1].tobytes()


def _map_legend(width: int, size: tuple[int, int]) -> Image:
    """A strip below the map: how long an error of one pixel is drawn, and the size of the picture."""
    strip: Image = np.full((40, width, 3), 255, np.uint8)
    cv2.line(strip, (10, 20), (10 + _ERROR_MAGNIFICATION, 20), (0, 94, 213), 2, cv2.LINE_AA)
    legend = f"error of 1 px; dots: corners; picture {size[0]} x {size[1]} px"
    height = min(0.5, (width - _ERROR_MAGNIFICATION - 30) / 850)
    cv2.putText(
        strip,
        legend,
        (20 + _ERROR_MAGNIFICATION, 25),
        cv2.FONT_HERSHEY_SIMPLEX,
        height,
        (0, 0, 0),
        1,
        cv2.LINE_AA,
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
    alternative: FloatArray  # `values` of another model that fits as well, shape (9,)

    @property
    def values(self) -> FloatArray:
        """Focal length, centre and distortion, shape (9,)."""
        return np.concatenate([self.matrix[[0, 1], [0, 1]], self.matrix[:2, 2], self.distortion])


def _fit_lens(views: list[View], size: tuple[int, int]) -> _LensFit:
    two, three = (_fit_lens_model(views, size, flags) for flags in (cv2.CALIB_FIX_K3, 0))
    if three.rms < _K3_ERROR_RATIO * two.rms:
        return replace(three, alternative=three.values)  # two terms are refuted
    return replace(two, alternative=three.values)


def _fit_lens_model(views: list[View], size: tuple[int, int], flags: int) -> _LensFit:
    points = [v.points.astype(np.float32) for v in views]
    pixels = [v.pixels.astype(np.float32) for v in views]
    start, none = np.eye(3), np.zeros(5)  # overwritten: there is no first guess
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


def _best_corner_method(detected: Views) -> tuple[list[View], list[list[View]]]:
    """The views with the corners of the method that fits a lens best, and the views of each method."""
    methods = range(1 + min(len(v.alternatives) for v in detected.views))
    views_by_method = [[v.with_corners_by(m) for v in detected.views] for m in methods]
    best = min(views_by_method, key=lambda views: _fit_lens_model(views, detected.size, cv2.CALIB_FIX_K3).rms)
    return best, views_by_method if len(views_by_method) > 1 else []


def _standard_deviations(fit: _LensFit, views: list[View], others: list[_LensFit]) -> FloatArray:
    """Standard deviations of focal length, centre and distortion, shape (9,).

    Corners of one view err together (a sheet that is not flat, blur), so the scatter of corners understates
    them: the views' scatter is taken where it is larger. What another model of the lens and other methods
    to locate corners change is added, because no view shows which of them is right.
    """
    scatter = np.maximum(fit.deviation, _jackknife_deviations(fit, views))
    model = fit.values - fit.alternative
    methods = np.std([other.values for other in others], axis=0, ddof=1) if others else np.zeros(9)
    deviation = np.sqrt(scatter**2 + model**2 + methods**2)
    return np.where(fit.deviation > 0, deviation, 0.0)


def _jackknife_deviations(fit: _LensFit, views: list[View]) -> FloatArray:
    """Standard deviations (9,) by leaving out each view in turn (jackknife), linearised at the fit.

    The poses are eliminated from the normal equations (Schur complement), so no view is fitted again.
    """
    free = fit.deviation > 0
    information, gradients = [], []
    for view, (rotation, shift) in zip(views, fit.poses, strict=True):
        projected, jacobian = cv2.projectPoints(view.points, rotation, shift, fit.matrix, fit.distortion)
        residual = (view.pixels - projected[:, 0]).ravel()
        pose, lens = jacobian[:, :6], jacobian[:, 6:15][:, free]
        reduced = lens - pose @ np.linalg.lstsq(pose, lens, rcond=None)[0]
        information.append(reduced.T @ reduced)
        gradients.append(reduced.T @ residual)
    total = np.sum(information, axis=0)
    n = len(views)
    estimates = np.array([np.linalg.solve(total - i, p) for i, p in zip(information, gradients, strict=True)])
    deviation = np.zeros(9)
    deviation[free] = np.sqrt((n - 1) / n * ((estimates - estimates.mean(axis=0)) ** 2).sum(axis=0))
    return deviation


def _require_enough(detected: Views) -> None:
    if len(detected.views) < _MIN_VIEWS:
        without_pattern = (
            f", {len(detected.without_pattern)} show no pattern (such as {detected.without_pattern[0]})"
            if detected.without_pattern
            else ""
        )
        duplicates = (
            f", {detected.duplicates} show it at the same place as another" if detected.duplicates else ""
        )
        raise InputError(
            "too few views to calibrate the camera",
            code="camera.too-few-views",
            expected=f"at least {_MIN_VIEWS} that differ",
            found=f"{len(detected.views)}{without_pattern}{duplicates}",
            remedy="add views: in every corner, tilted, near; a chessboard needs --chessboard",
        )
    cells = coverage(detected.views, detected.size)
    empty = [name for name, n in zip(_CELL_NAMES, cells, strict=True) if n == 0]
    if empty:
        raise InputError(
            "the views do not cover the whole picture",
            code="camera.views-at-places",
            expected="corners in every ninth of the picture",
            found=f"none at the {', '.join(empty)}",
            remedy="add views with the pattern there",
        )


def _require_tilts(tilts: FloatArray, count: int) -> None:
    steep = np.abs(tilts) > _MIN_TILT
    for axis, name in ((0, "left or right"), (1, "up or down")):
        if steep[:, axis].sum() < _MIN_TILTED_VIEWS:
            raise InputError(
                "the views are too similar",
                code="camera.views-alike",
                expected=f"{_MIN_TILTED_VIEWS} with the pattern turned {name} by {_MIN_TILT:.0f} degrees",
                found=f"{steep[:, axis].sum()} of {count}",
                remedy=f"add views with the pattern turned {name} by 30 to 45 degrees",
            )


def _bootstrap_interval(errors: FloatArray) -> tuple[float, float]:
    """95 % interval of the RMS error over views, by bootstrap."""
    rng = np.random.default_rng(0)
    samples = rng.integers(0, len(errors), (2000, len(errors)))
    low, high = np.percentile(np.sqrt((errors[samples] ** 2).mean(axis=1)), [2.5, 97.5])
    return float(low), float(high)

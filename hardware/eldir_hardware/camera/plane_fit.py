"""The plane of motion from pictures of its reference tags: homography and distortion by least squares."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import Image, Plane, TagBoard
from eldir_hardware.camera.tags import MIN_TAGS, locate_tags

_EDGE_BLEED, _MAX_EDGE_BLEED = 0.23, 0.3
"""By how much white grows over each edge of black in a picture, for the camera's tone curve, and by how much
this may differ [px]."""
_MAX_SIZE_ERROR = 0.01
"""Tags whose size differs by more than this part, and more than edges bleed, have another scale."""
_MAX_RMS = 0.5
"""With a larger error the tags are not at the places in the tag file, or not flat [px]."""
_MAX_LENS_ERROR = 3.0
"""A lens whose distortion differs by more from the tags' at the outermost tag is of another camera [px]."""
# Priors of a webcam's lens, as standard deviations: they fix what four tags cannot determine.
_PRIOR_CENTRE = 6.0  # [px]
_PRIOR_RADIAL = np.array([0.1, 0.02])
_CALIBRATED_PRIOR = 0.1  # factor of these priors for a calibrated lens
_PRIOR_GROWTH = 0.5e-3  # ink, glare and the tone curve move all edges of a tag alike [m]
_CORNER_NOISE = 0.05  # of a tag's corner [px]
_TOO_FEW_REMEDY = "light them evenly, uncover them, check the tag file; a border must be 4 pixels wide"
_MIRRORED_REMEDY = (
    "the pictures are mirrored, as a mirror or a camera for video calls shows them: flip them back"
)


class WrongLensError(InputError):
    """The lens is that of another camera than the one that took the pictures."""

    code = "camera.wrong-lens"


def calibrate_plane(
    images: Iterable[Image],
    board: TagBoard,
    provenance: dict[str, Any] | None = None,
    lens: Lens | None = None,
) -> Plane:
    """Find the plane of motion from the mean of several pictures (H, W, 3) or (H, W) of one camera.

    A calibrated `lens` improves the accuracy. Raises `InputError` if fewer than four tags of the board are
    visible or the tags do not fit, and `WrongLensError` if the lens does not fit.
    """
    images = list(images)
    detections = [locate_tags(image, board) for image in images]
    width, height = _common_size(images)
    if lens is not None:
        lens.require_size(width, height)
    visible = [i for i in board.ids if sum(i in tags for tags in detections) > len(detections) / 2]
    if len(visible) < MIN_TAGS:
        raise _too_few_tags(images[0], board, visible)
    pixels = np.array([np.mean([tags[i] for tags in detections if i in tags], axis=0) for i in visible])
    rows = [board.ids.index(i) for i in visible]
    plane = fit_plane(board.corners[rows], board.centres[rows], pixels, (width, height), lens)
    origin = {"tags": visible, "pictures": len(images), "board": board.to_json(), "eldir": version("eldir")}
    origin |= provenance or {}
    if remark := _tag_size_remark(plane, board, visible, pixels):
        origin["remark"] = f"{origin['remark']} {remark}" if "remark" in origin else remark
    return replace(plane, provenance=origin)


def _common_size(images: list[Image]) -> tuple[int, int]:
    """Width and height of all pictures [px]. Raises `InputError` where they differ, or without pictures."""
    if not images:
        raise InputError(
            "no picture to calibrate the plane from",
            code="camera.no-picture",
            expected="at least 1",
            found="0",
        )
    sizes = sorted({f"{image.shape[1]} x {image.shape[0]}" for image in images})
    if len(sizes) > 1:
        raise InputError(
            "the pictures differ in size",
            code="camera.sizes-differ",
            expected="one size",
            found=" and ".join(sizes),
        )
    height, width = images[0].shape[:2]
    return width, height


def _too_few_tags(image: Image, board: TagBoard, visible: list[int]) -> InputError:
    mirrored = len(locate_tags(np.ascontiguousarray(image[:, ::-1]), board)) >= MIN_TAGS
    return InputError(
        "too few tags to find the plane of motion",
        code="plane.too-few-tags",
        expected=f"at least {MIN_TAGS} of the tags {', '.join(map(str, board.ids))} in most pictures",
        found=", ".join(map(str, visible)) or "none",
        remedy=_MIRRORED_REMEDY if mirrored else _TOO_FEW_REMEDY,
    )


def _tag_size_remark(plane: Plane, board: TagBoard, numbers: list[int], pixels: FloatArray) -> str:
    """A remark where the tags with these numbers, at corners `pixels` (N, 4, 2), have another size than the
    tag file says; else empty. The distances between the tags give the plane, so that their sizes can be
    compared with it."""
    corners = plane.to_metres(pixels)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean(axis=1)
    pixel = 1 / float(plane.pixels_per_metre(board.centres.mean(axis=0)))
    sides = sides + 2 * _EDGE_BLEED * pixel
    limit = max(_MAX_SIZE_ERROR * board.side_m, 2 * _MAX_EDGE_BLEED * pixel)
    median = float(np.median(sides))
    remedy = (
        "check the scale bar of the print with calipers, and give their true size as side_m in the tag file."
    )
    if abs(median - board.side_m) > limit:
        return (
            f"The reference tags are about {1e3 * median:.1f} mm wide, compared with the distances between "
            f"them; the tag file says {1e3 * board.side_m:.1f} mm: {remedy}"
        )
    odd = np.abs(sides - median) > limit
    if odd.any():
        listed = ", ".join(
            f"{n} {1e3 * s:.1f} mm" for n, s, o in zip(numbers, sides.tolist(), odd, strict=True) if o
        )
        return f"Reference tags differ in size: {listed}, the others {1e3 * median:.1f} mm: {remedy}"
    return ""


def fit_plane(
    corners: FloatArray,
    centres: FloatArray,
    pixels: FloatArray,
    size: tuple[int, int],
    lens: Lens | None = None,
) -> Plane:
    """Fit a plane by least squares to tag corners (N, 4, 2) [m] at `pixels` of the same shape [px].

    `centres`: of the tags [m], shape (N, 2). `size`: of the pictures [px]. The unknowns are the homography,
    the centre of distortion, two radial terms, and how much larger or smaller than printed all tags appear.
    With a `lens` the distortion may change only a little. Raises `InputError` where the tags do not fit.
    """
    middle, spread = centres.mean(axis=0), float(np.ptp(centres, axis=0).max())
    normalisation = np.diag([1 / spread, 1 / spread, 1.0])
    normalisation[:2, 2] = -middle / spread
    image_centre = (np.array(size) - 1) / 2 if lens is None else lens.centre_px
    radial = np.zeros(2) if lens is None else lens.radial
    prior = 1.0 if lens is None else _CALIBRATED_PRIOR
    unit = float(np.hypot(*size)) / 2
    outward = np.sign(corners - centres[:, None])
    targets = ((pixels - image_centre) / unit).reshape(-1, 2)
    start, _ = cv2.findHomography(((corners - middle) / spread).reshape(-1, 2), targets)

    def to_plane(x: FloatArray) -> Plane:
        homography = np.append(x[:8], 1.0).reshape(3, 3) @ normalisation
        centre = image_centre + prior * _PRIOR_CENTRE * x[8:10]
        return Plane(*size, homography, centre, radial + prior * _PRIOR_RADIAL * x[10:12], 0.0)

    def reprojection_error(x: FloatArray) -> FloatArray:
        return to_plane(x).to_pixels(corners + _PRIOR_GROWTH * x[12] * outward) - pixels

    def residuals(x: FloatArray) -> FloatArray:
        return np.concatenate([reprojection_error(x).ravel() / _CORNER_NOISE, x[8:]])

    x0 = np.concatenate([(start / start[2, 2]).ravel()[:8], np.zeros(5)])
    best = least_squares(residuals, x0, method="lm").x
    rms = float(np.sqrt((reprojection_error(best) ** 2).sum(axis=-1).mean()))
    if not rms < _MAX_RMS:
        raise InputError(
            "the tags are not at the places in the tag file",
            code="plane.tags-elsewhere",
            expected=f"a reprojection error below {_MAX_RMS} px",
            found=f"{rms:.2f} px",
            remedy="measure their positions again; all tags must lie flat in the plane of motion",
        )
    plane = to_plane(best)
    if lens is not None:
        _require_matching_lens(lens, plane, pixels)
    return replace(plane, rms_px=rms)


def _require_matching_lens(lens: Lens, plane: Plane, pixels: FloatArray) -> None:
    """Refuse a lens whose distortion differs from that of the tags, which is known to a tenth of a pixel."""
    r = np.linalg.norm((pixels - lens.centre_px) / plane.half_diagonal_px, axis=-1).max()
    error = plane.half_diagonal_px * abs(np.dot(plane.radial - lens.radial, [r**3, r**5]))
    if error > _MAX_LENS_ERROR:
        raise WrongLensError(
            "the calibration is that of another lens or zoom setting",
            expected=f"the distortion that the tags show, to {_MAX_LENS_ERROR:g} px",
            found=f"a difference of {error:.1f} px at the outermost tag",
            remedy="calibrate this camera again",
        )

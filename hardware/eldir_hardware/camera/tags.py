"""The plane of motion found in pictures: tags located along their edges, homography and lens fitted.

The input is pictures and the positions of the tags.
"""

from __future__ import annotations

import math
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

_LEAST_TAGS = 4
_REACH = 3.0
"""How far to either side of an edge its profile is read [px]; the border of a tag must be wider."""
_EDGE_SHIFT, _MAX_EDGE_SHIFT = 0.23, 0.3
"""By how much white grows over each edge of black in a picture, for the camera's tone curve, and by how much
this may differ [px]."""
_MAX_PRINT_ERROR = 0.01
"""Tags whose size differs by more than this part, and more than edges shift, have another scale."""
_WORST_RMS = 0.5
"""With a larger error the tags are not at the places in the tag file, or not flat [px]."""
_OTHER_LENS = 3.0
"""A lens whose distortion differs by more from the tags' at the outermost tag is of another camera [px]."""
# Priors of a webcam's lens, as standard deviations: they fix what four tags cannot determine.
_PRIOR_CENTRE = 6.0  # [px]
_PRIOR_RADIAL = np.array([0.1, 0.02])
_KNOWN = 0.1  # of these, where the lens was calibrated
_PRIOR_GROWTH = 0.5e-3  # ink, glare and the tone curve move all edges of a tag alike [m]


_MIRRORED = "the pictures are mirrored, as a mirror or a camera for video calls shows them: flip them back"


class WrongLensError(InputError):
    """The lens file belongs to another camera than the one that took the pictures."""

    code = "camera.wrong-lens"


def calibrate_plane(
    images: Iterable[Image],
    board: TagBoard,
    provenance: dict[str, Any] | None = None,
    lens: Lens | None = None,
) -> Plane:
    """Find the plane of motion from the mean of several pictures of one camera.

    A calibrated `lens` improves the accuracy. Raises `InputError` if fewer than four tags of the board are
    seen or the tags do not fit, and `WrongLensError` if the lens does not fit.
    """
    images = list(images)
    seen = [(image.shape, locate_tags(image, board)) for image in images]
    if not seen:
        raise InputError(
            "no picture to calibrate the plane from",
            code="camera.no-picture",
            expected="at least 1",
            found="0",
        )
    sizes = sorted({f"{shape[1]} x {shape[0]}" for shape, _ in seen})
    if len(sizes) > 1:
        raise InputError(
            "the pictures differ in size",
            code="camera.sizes-differ",
            expected="one size",
            found=" and ".join(sizes),
        )
    height, width = seen[0][0][:2]
    if lens is not None:
        lens.require_size(width, height)
    often = [i for i in board.ids if sum(i in tags for _, tags in seen) > len(seen) / 2]
    if len(often) < _LEAST_TAGS:
        mirrored = len(locate_tags(np.ascontiguousarray(images[0][:, ::-1]), board)) >= _LEAST_TAGS
        raise InputError(
            "too few tags to find the plane of motion",
            code="plane.too-few-tags",
            expected=f"at least {_LEAST_TAGS} of the tags {_listed(board.ids)} in most pictures",
            found=_listed(often) or "none",
            remedy=_MIRRORED
            if mirrored
            else "light them evenly, uncover them, check the tag file; a border must be 4 pixels wide",
        )
    pixels = np.array([np.mean([tags[i] for _, tags in seen if i in tags], axis=0) for i in often])
    rows = [board.ids.index(i) for i in often]
    plane = fit_plane(board.corners[rows], board.centres[rows], pixels, (width, height), lens)
    made = {"tags": often, "pictures": len(seen), "board": board.to_json(), "eldir": version("eldir")}
    made |= provenance or {}
    if remark := _print_remark(plane, board, often, pixels):
        made["remark"] = f"{made['remark']} {remark}" if "remark" in made else remark
    return replace(plane, provenance=made)


def _print_remark(plane: Plane, board: TagBoard, numbers: list[int], pixels: FloatArray) -> str:
    """What the sizes of the tags with these numbers, at corners `pixels` (N, 4, 2), say about their print:
    the distances between the tags give the plane, so their sizes can be compared with it. Empty if right."""
    corners = plane.to_metres(pixels)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean(axis=1)
    pixel = 1 / float(plane.pixels_per_metre(board.centres.mean(axis=0)))
    sides = sides + 2 * _EDGE_SHIFT * pixel
    limit = max(_MAX_PRINT_ERROR * board.side_m, 2 * _MAX_EDGE_SHIFT * pixel)
    usual = float(np.median(sides))
    how = (
        "check the scale bar of the print with calipers, and give their true size as side_m in the tag file."
    )
    if abs(usual - board.side_m) > limit:
        return (
            f"The reference tags are about {1e3 * usual:.1f} mm wide, compared with the distances between "
            f"them; the tag file says {1e3 * board.side_m:.1f} mm: {how}"
        )
    odd = np.abs(sides - usual) > limit
    if odd.any():
        listed = ", ".join(
            f"{n} {1e3 * s:.1f} mm" for n, s, o in zip(numbers, sides.tolist(), odd, strict=True) if o
        )
        return f"Reference tags differ in size: {listed}, the others {1e3 * usual:.1f} mm: {how}"
    return ""


def _listed(numbers: list[int]) -> str:
    return ", ".join(map(str, numbers))


def require_dictionary(name: str, count: int = 1) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of that name. Raises `InputError` if there is none with `count` tags."""
    number = getattr(cv2.aruco, name, None)
    if not (isinstance(number, int) and name.startswith("DICT_")):
        raise InputError(
            "unknown tag dictionary",
            code="tags.unknown-dictionary",
            expected="such as DICT_4X4_50",
            found=name,
        )
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    if count > len(dictionary.bytesList):
        raise InputError(
            "too many tags",
            code="tags.too-many",
            expected=f"at most {len(dictionary.bytesList)} of {name}",
            found=str(count),
        )
    return dictionary


def locate_tags(image: Image, board: TagBoard) -> dict[int, FloatArray]:
    """Corners (4, 2) [px] of each tag of the board that is seen, found as crossings of its edges.

    OpenCV's own refinements are biased for small tags, because a blurred corner is round; edges are not.
    """
    detector = cv2.aruco.ArucoDetector(require_dictionary(board.dictionary))
    grey: Image = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    readings: list[tuple[int, FloatArray]] = []
    for scale in (1, 2):  # twice the size finds smaller tags, and misses others
        larger = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        corners, ids, _ = detector.detectMarkers(larger)
        for i, c in zip([] if ids is None else ids.ravel(), corners, strict=False):
            readings.append((int(i), (c[0].astype(np.float64) + 0.5) / scale - 0.5))
    found = _without_reflections(readings, board)
    cells = detector.getDictionary().markerSize + 2
    found = {i: c for i, c in found.items() if np.linalg.norm(c[0] - c[2]) > 1.41 * cells * (_REACH + 0.5)}
    return edges_at(grey, {i: found[i] for i in board.ids if i in found})


def _without_reflections(readings: list[tuple[int, FloatArray]], board: TagBoard) -> dict[int, FloatArray]:
    """One reading of each tag, corners (4, 2) [px]; of a number that is read at several places, the one where
    the others say that the tag is.

    A reflection shows a tag upside down and mirrored; some such pictures read as the same number, turned.
    """
    if not readings:
        return {}
    tops = np.array([c[1] - c[0] for _, c in readings])
    turns = np.round(np.arctan2(tops[:, 1], tops[:, 0]) / (np.pi / 2)).astype(int) % 4
    usual = np.bincount(turns, minlength=4).argmax()
    upright: dict[int, list[FloatArray]] = {}
    for (i, corners), turn in zip(readings, turns.tolist(), strict=True):
        others = upright.setdefault(i, []) if turn == usual else []
        near = [np.hypot(*(corners - c).mean(axis=0)) < np.linalg.norm(c[0] - c[2]) / 2 for c in others]
        if any(near):
            others[near.index(True)] = corners  # the same tag, measured in the larger copy
        else:
            others.append(corners)
    once = {i: c[0] for i, c in upright.items() if len(c) == 1}
    rows = {i: k for k, i in enumerate(board.ids)}
    known = [i for i in once if i in rows]
    if len(once) == len(upright) or len(known) < _LEAST_TAGS:
        return once
    places = board.centres[[rows[i] for i in known]]
    to_pixels, _ = cv2.findHomography(places, np.array([once[i].mean(axis=0) for i in known]))
    for i in set(upright) - set(once):
        if to_pixels is not None and i in rows:
            expected = cv2.perspectiveTransform(board.centres[rows[i]].reshape(1, 1, 2), to_pixels).ravel()
            once[i] = min(upright[i], key=lambda c: float(np.hypot(*(c.mean(axis=0) - expected))))
    return once


def edges_at(image: Image, corners: dict[int, FloatArray]) -> dict[int, FloatArray]:
    """Corners (4, 2) [px] of tags that are known to a few pixels, found as crossings of their edges."""
    grey: Image = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    refined = {i: cross_edges(grey, c) for i, c in corners.items()}
    return {i: c for i, c in refined.items() if np.isfinite(c).all()}


def fit_plane(
    corners: FloatArray,
    centres: FloatArray,
    pixels: FloatArray,
    size: tuple[int, int],
    lens: Lens | None = None,
) -> Plane:
    """Fit a plane by least squares to tag corners (N, 4, 2) [m], seen at pixels of the same shape.

    The unknowns are the homography, the centre of distortion, two radial terms, and how much larger or
    smaller than printed all tags appear. With a `lens` the distortion may change only a little.
    """
    middle, spread = centres.mean(axis=0), float(np.ptp(centres, axis=0).max())
    scaled = np.diag([1 / spread, 1 / spread, 1.0])
    scaled[:2, 2] = -middle / spread
    image_centre = (np.array(size) - 1) / 2 if lens is None else lens.centre_px
    radial = np.zeros(2) if lens is None else lens.radial
    known = 1.0 if lens is None else _KNOWN
    unit = float(np.hypot(*size)) / 2
    outward = np.sign(corners - centres[:, None])
    targets = ((pixels - image_centre) / unit).reshape(-1, 2)
    start, _ = cv2.findHomography(((corners - middle) / spread).reshape(-1, 2), targets)

    def plane_of(x: FloatArray) -> Plane:
        homography = np.append(x[:8], 1.0).reshape(3, 3) @ scaled
        centre = image_centre + known * _PRIOR_CENTRE * x[8:10]
        return Plane(*size, homography, centre, radial + known * _PRIOR_RADIAL * x[10:12], 0.0)

    def reprojection_error(x: FloatArray) -> FloatArray:
        return plane_of(x).to_pixels(corners + _PRIOR_GROWTH * x[12] * outward) - pixels

    def residuals(x: FloatArray) -> FloatArray:
        return np.concatenate([reprojection_error(x).ravel() / 0.05, x[8:]])  # corners are good to 0.05 px

    x0 = np.concatenate([(start / start[2, 2]).ravel()[:8], np.zeros(5)])
    best = least_squares(residuals, x0, method="lm").x
    rms = float(np.sqrt((reprojection_error(best) ** 2).sum(axis=-1).mean()))
    if not rms < _WORST_RMS:
        raise InputError(
            "the tags are not at the places in the tag file",
            code="plane.tags-elsewhere",
            expected=f"a reprojection error below {_WORST_RMS} px",
            found=f"{rms:.2f} px",
            remedy="measure their positions again; all tags must lie flat in the plane of motion",
        )
    plane = plane_of(best)
    if lens is not None:
        _require_lens(lens, plane, pixels)
    return replace(plane, rms_px=rms)


def _require_lens(lens: Lens, plane: Plane, pixels: FloatArray) -> None:
    """Refuse a lens whose distortion differs from that of the tags, which is known to a tenth of a pixel."""
    r = np.linalg.norm((pixels - lens.centre_px) / plane.unit, axis=-1).max()
    off = plane.unit * abs(np.dot(plane.radial - lens.radial, [r**3, r**5]))
    if off > _OTHER_LENS:
        raise WrongLensError(
            "the lens file belongs to another lens or zoom setting",
            expected=f"the distortion that the tags show, to {_OTHER_LENS:g} px",
            found=f"{off:.1f} px off at the outermost tag",
            remedy="calibrate this camera again",
        )


def cross_edges(grey: Image, corners: FloatArray, reach: float = _REACH) -> FloatArray:
    """Corners (4, 2) again, as crossings of lines through the four edges; NaN where there is no edge.

    `reach`: how far to either side of an edge its profile is read [px], less than the border is wide.
    """
    for _ in range(2):  # the second time, profiles are centred
        lines = [_edge(grey, corners[i], corners[(i + 1) % 4], reach) for i in range(4)]
        crossings = np.array([_crossing(lines[i - 1], lines[i]) for i in range(4)])
        if not np.isfinite(crossings).all():
            return np.full((4, 2), np.nan)
        corners = crossings
    return corners


_Line = tuple[float, float, float]
"""Of points (x, y) with l0 x + l1 y + l2 = 0 [px]."""
_NO_LINE = (math.nan, math.nan, math.nan)


def _crossing(one: _Line, other: _Line) -> tuple[float, float]:
    (a, b, c), (p, q, r) = one, other
    w = a * q - b * p
    return ((b * r - c * q) / w, (c * p - a * r) / w) if w else (math.nan, math.nan)


def _edge(grey: Image, a: FloatArray, b: FloatArray, reach: float) -> _Line:
    """Line along the edge from a to b, dark on its right hand."""
    span = b - a
    length = math.hypot(*span)
    along = span / length
    out = np.array([along[1], -along[0]])  # corners run clockwise as seen, y down
    margin = (reach + 1) / length
    at = np.linspace(margin, 1 - margin, max(8, int(length)))
    offsets = np.linspace(-reach, reach, round(4 * reach) + 1)
    # No (N, 13, 2) of both coordinates: numpy takes several times as long over an axis of two.
    x, y = ((a[d] + at * span[d])[:, None] + offsets * out[d] for d in range(2))
    profile = cv2.remap(grey, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR).astype(np.float64)
    first, second, *_ = profile.T
    *_, last_but_one, last = profile.T
    dark, bright = (first + second) / 2, (last_but_one + last) / 2
    rise = bright - dark
    sharp = rise > 20
    if sharp.sum() < 5:
        return _NO_LINE
    # A step from dark to bright at s has the mean bright + (dark - bright) (s + reach) / (2 reach).
    inner = (profile.sum(axis=1) - (first + last) / 2) / (len(offsets) - 1)
    s = 2 * reach * (bright[sharp] - inner[sharp]) / rise[sharp] - reach
    slope, offset = _line_fit(at[sharp] - 0.5, s)
    middle = (a + b) / 2 + offset * out
    direction = along * length + slope * out
    normal = direction[1], -direction[0]
    return float(normal[0]), float(normal[1]), float(-(normal[0] * middle[0] + normal[1] * middle[1]))


def _line_fit(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope, and value at 0, of the straight line through points (N,) by least squares."""
    mean = x.sum() / len(x)
    from_mean = x - mean
    slope = float(from_mean @ y / (from_mean @ from_mean))
    return slope, float(y.sum() / len(y) - slope * mean)

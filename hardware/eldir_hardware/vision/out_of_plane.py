"""How far a filmed robot left the plane of motion, from its markers: it may turn, lean, come nearer or fall.

A camera sees a strip shorter that is farther away or at an angle, and a marker smaller. Both are compared
with the first second, in which the robot stands as it was put. Hubs turn and strips have play, so that the
apparent lengths of strips between markers say little by themselves: the result is an interval, from the
posterior on a grid of yaw, lean and depth. The markers are taken to lie in one plane of the robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir.trajectory import Trajectory
from eldir_hardware.camera.plane import Plane, estimate_camera_pose

REFERENCE_S = 1.0
"""The robot stands as it was put for this long at the start of a film [s]."""
_LENGTH_ERROR, _SIZE_ERROR = 0.008, 0.03
"""Relative errors of an apparent length of a strip and of an apparent size of a marker, standard deviations:
so that the intervals hold what MuJoCo knows (docs/reference/second-physics-measured.md). Within the length's
are hubs that turn by 15 degrees and strips that lean by their play."""
_INDEPENDENT_STRIPS = 2
"""More strips count as this many: hubs that turn shorten several at once."""
_YAW_SPREAD, _LEAN_SPREAD, _DEPTH_SPREAD = np.radians(20.0), np.radians(8.0), 0.04
"""Prior standard deviations: of robots with both faces in MuJoCo. Depth: share of the camera's distance."""
_ASSUMED_FOCAL = 1.1
"""Focal length of a camera without a lens file [widths of the picture]. Depths are shares of the distance, so
that they hardly depend on it."""
_FALL_LENGTH = 0.95
"""Apparent length of strips just before all markers vanish, relative to a second before, below which the
robot is falling. At ten pictures a second a fall is seen in two or three."""
_LOSS_S = 1.0
"""Time before all markers vanish with which lengths are compared, and least time without them [s]."""


@dataclass(frozen=True)
class Interval95:
    """Median and 95 % interval of a posterior."""

    low: float
    median: float
    high: float


@dataclass(frozen=True)
class PlaneDeparture:
    """How the robot stands at one time, compared with the start."""

    yaw: Interval95
    """Rotation about the vertical, to either side [rad]."""
    lean: Interval95
    """Lean to either side [rad]."""
    depth: Interval95
    """How far its markers are behind the plane of motion, as a share of the camera's distance to it; negative
    where they are nearer."""
    foot_x: float
    """Where the way from the camera meets the plane of motion at right angles, forward [m]."""
    markers_x: float
    """Mean place of the markers in the film, forward [m]."""

    @property
    def is_certain(self) -> bool:
        """Whether the markers show that the robot is out of its plane."""
        off = self.depth.low > 0 or self.depth.high < 0
        return off or max(self.yaw.low, self.lean.low) > 0

    def path_error(self, half_width: float, half_length: float) -> float:
        """Largest error of the place of the robot's middle if its markers are taken to be in the plane [m],
        95 %. Markers nearer to the camera seem farther from its axis. A robot of this half width and half
        length that turns moves its markers, on its front and at its end."""
        largest = max(abs(self.depth.low), abs(self.depth.high)) * abs(self.markers_x - self.foot_x)
        turned = half_width * np.sin(self.yaw.high) + half_length * (1 - np.cos(self.yaw.high))
        return float(np.hypot(largest, turned))


@dataclass(frozen=True)
class MarkerLoss:
    """All markers vanished until the end of the film."""

    last_seen_s: float
    """Time of the last picture with a marker [s]."""
    fell: bool
    """Whether the strips looked shorter just before: the robot fell over sideways. A faster fall, a robot
    that leaves the picture, and one that is covered look alike."""


class PlaneObserver:
    """Estimates from one film."""

    def __init__(
        self,
        trajectory: Trajectory,
        sizes: FloatArray,
        strips: IntArray,
        plane: Plane,
        focal: float | None = None,
    ):
        """`sizes` (T, K): how large each marker appears, in any unit; `strips` (P, 2): pairs of markers that
        a strip joins; `focal` [px]: of a calibrated lens."""
        self._path, self._sizes, self._strips = trajectory, sizes, strips
        position = estimate_camera_pose(plane, focal or _ASSUMED_FOCAL * plane.width_px).position
        self._foot, self._distance = position[[0, 2]], -float(position[1])
        first = trajectory.times - trajectory.times[:1] <= REFERENCE_S
        self._first_sizes = _medians(sizes, first)
        self._first_lengths = _medians(self._lengths, first)

    @property
    def _lengths(self) -> FloatArray:
        """Apparent lengths of the strips in each frame [m], shape (T, P)."""
        ends = self._path.positions[:, self._strips]
        return np.asarray(np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=-1))

    def estimate(self, begin: float, end: float) -> PlaneDeparture | None:
        """How the robot stands between two times [s]; None where no strip between markers was seen."""
        inside = (self._path.times >= begin) & (self._path.times < end)
        places = _medians(self._path.positions.reshape(len(inside), -1), inside).reshape(-1, 2)
        seen = np.isfinite(places[:, 0])
        strips = [
            (a, b, length)
            for (a, b), length in zip(self._strips.tolist(), self._first_lengths.tolist(), strict=True)
            if seen[a] and seen[b] and np.isfinite(length)
        ]
        if not strips:
            return None
        relative_sizes = _medians(self._sizes, inside) / self._first_sizes
        return self._fit(places, strips, relative_sizes, seen)

    def _fit(
        self, places: FloatArray, strips: list[tuple[int, int, float]], sizes: FloatArray, seen: BoolArray
    ) -> PlaneDeparture:
        middle = places[seen].mean(axis=0)
        offsets = {k: self._offset(places[k], middle) for k in np.flatnonzero(seen).tolist()}
        misfit = (_YAW / _YAW_SPREAD) ** 2 + (_LEAN / _LEAN_SPREAD) ** 2 + (_DEPTH / _DEPTH_SPREAD) ** 2
        together = min(1.0, _INDEPENDENT_STRIPS / len(strips))
        for a, b, length in strips:
            found = np.sqrt(sum((u - v) ** 2 for u, v in zip(offsets[a], offsets[b], strict=True)))
            misfit = misfit + together * ((found / length - 1) / _LENGTH_ERROR) ** 2
        for k, (x, depth, z) in offsets.items():
            if np.isfinite(sizes[k]):
                # A disc's area by the angle at which it is seen, and by its distance.
                far = self._distance + depth
                seen_area = (1 - (_SLOPE_X * x + _SLOPE_Z * z) / far) / np.sqrt(1 + _SLOPE_X**2 + _SLOPE_Z**2)
                expected = np.sqrt(np.maximum(seen_area, 1e-3)) * self._distance / far
                misfit = misfit + ((sizes[k] / expected - 1) / _SIZE_ERROR) ** 2
        weight = np.exp((misfit.min() - misfit) / 2)
        return PlaneDeparture(
            _interval(np.abs(_YAWS), weight.sum(axis=(1, 2))),
            _interval(np.abs(_LEANS), weight.sum(axis=(0, 2))),
            _interval(_DEPTHS, weight.sum(axis=(0, 1))),
            float(self._foot[0]),
            float(middle[0]),
        )

    def _offset(self, place: FloatArray, middle: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Where the ray to a place in the plane meets the plane of the markers, for every yaw, lean and
        depth: forward from the foot, behind the plane of motion, up from the foot [m]."""
        (x, z), (mx, mz) = place - self._foot, middle - self._foot
        far = self._distance * (1 + _DEPTH) - _SLOPE_X * mx - _SLOPE_Z * mz
        stretch = far / (self._distance - _SLOPE_X * x - _SLOPE_Z * z)
        return stretch * x, (stretch - 1) * self._distance, stretch * z

    def find_loss(self) -> MarkerLoss | None:
        """When all markers vanished for good; None where some are seen until a second before the end, or none
        ever was."""
        lengths, times = self._lengths, self._path.times
        seen = np.flatnonzero(np.isfinite(self._path.positions).any(axis=(1, 2)))
        if not len(seen) or times[-1] - times[seen[-1]] < _LOSS_S:
            return None
        last = float(times[seen[-1]])
        before = _medians(lengths, (times <= last - _LOSS_S / 2) & (times >= last - 3 * _LOSS_S / 2))
        recent = lengths[times > last - _LOSS_S / 2] / before
        fell = np.isfinite(recent).any() and float(np.nanmin(recent)) < _FALL_LENGTH
        return MarkerLoss(last, bool(fell))


_YAWS, _LEANS = np.radians(np.arange(-50.0, 51.0, 5.0)), np.radians(np.arange(-50.0, 51.0, 2.5))
_DEPTHS = np.linspace(-0.12, 0.12, 49)
_YAW, _LEAN, _DEPTH = np.meshgrid(_YAWS, _LEANS, _DEPTHS, indexing="ij")
# Of the plane of the markers, to the back for each metre forward and up.
_SLOPE_X, _SLOPE_Z = np.tan(_YAW), np.tan(_LEAN) / np.cos(_YAW)


def _interval(values: FloatArray, weights: FloatArray) -> Interval95:
    """Of values on a grid with these weights, in any order; between grid points nothing is resolved."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order]) / weights.sum()
    low, median, high = (float(values[order][np.searchsorted(below, q)]) for q in (0.025, 0.5, 0.975))
    return Interval95(low, median, high)


def _medians(values: FloatArray, rows: BoolArray) -> FloatArray:
    """Medians of the columns over some rows; NaN for a column without a value there."""
    chosen = values[rows]
    known = np.isfinite(chosen).any(axis=0)
    found = np.full(values.shape[1], np.nan)
    if known.any():
        found[known] = np.nanmedian(chosen[:, known], axis=0)
    return found

"""Quality of a tracked motion: missing frames, covered markers, motion out of the plane."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from eldir.core.records import FloatArray, Record, Rounded, record
from eldir.trajectory import Trajectory

MAX_SIZE_CHANGE = 0.05
"""A marker whose apparent size changes by more than this share has left the plane, or tilted."""
_SMOOTHING_FRAMES = 5  # frames over whose median a marker's size is smoothed


Number = Annotated[float, Rounded(6)]
Numbers = tuple[Number, ...]
Count = Annotated[int, Field(ge=0)]


@record
class TrackingQuality(Record):
    """Counts and shares; for markers in the order of their names."""

    frames: Count
    """Number of frames."""
    rate_hz: Annotated[float, Rounded(6, ge=0)]
    """Frame rate: one over the median time between frames [Hz]."""
    dropped_frames: Count
    """Missing frames, judged by the timestamps of the others."""
    repeated_times: Count
    """Frames that were left out because they are not later than the one before."""
    repeated_pictures: Count
    """Frames whose picture equals the one before: the camera or the recorder delivered it twice."""
    seen: Numbers
    """Share of frames in which each marker was measured, markers in order."""
    bridged: Numbers
    """Share of frames in which each marker was interpolated: it was measured shortly before and after."""
    longest_gap_s: Numbers
    """Longest time without a measurement of each marker [s], markers in order."""
    size_change: Numbers
    """Greatest relative change of each marker's apparent size from its median, markers in order; null if
    never seen."""
    size_resolution: Annotated[float, Rounded(6, ge=0)]
    """Relative change of a marker's apparent size with its position between pixels."""
    camera_drift_px: Number
    """Distance that the reference tags moved in the picture [px]; null if none were seen."""
    notes: tuple[str, ...] = ()
    """Notes on how the markers were found, such as objects that look like them, and on tags that were not
    seen."""

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        sizes: FloatArray,
        size_resolution: float = 0.0,
        repeated_times: int = 0,
        repeated_pictures: int = 0,
        camera_drift_px: float = math.nan,
        notes: tuple[str, ...] = (),
    ) -> TrackingQuality:
        """`sizes` (T, K): how large each marker appeared, in any unit; NaN where not seen."""
        t = trajectory.times
        gaps = np.diff(t)
        interval = float(np.median(gaps)) if len(gaps) else 0.0
        measured = np.isfinite(trajectory.positions[..., 0]) & ~trajectory.bridged
        return cls(
            frames=len(t),
            rate_hz=1 / interval if interval else 0.0,
            dropped_frames=int(np.round(gaps[gaps > 1.5 * interval] / interval - 1).sum()) if interval else 0,
            repeated_times=repeated_times,
            repeated_pictures=repeated_pictures,
            seen=tuple(measured.mean(axis=0).tolist()),
            bridged=tuple(trajectory.bridged.mean(axis=0).tolist()),
            longest_gap_s=tuple(_longest_gap(t, column) for column in measured.T),
            size_change=tuple(_max_size_change(column) for column in sizes.T),
            size_resolution=size_resolution,
            camera_drift_px=camera_drift_px,
            notes=notes,
        )

    def remarks(self, names: tuple[str, ...]) -> list[str]:
        """Warnings for a reader of the numbers."""
        remarks = list(self.notes)
        for name, share, gap in zip(names, self.seen, self.longest_gap_s, strict=True):
            if share < 0.95:
                remarks.append(
                    f"The camera saw {name} in only {share:.0%} of the frames; longest gap {gap:.1f} s."
                )
        if self.dropped_frames:
            remarks.append(f"{self.dropped_frames} frames are missing, judged by the timestamps.")
        if self.repeated_times or self.repeated_pictures:
            remarks.append(
                f"Frames with duplicate timestamps: {self.repeated_times} (left out); duplicate pictures: "
                f"{self.repeated_pictures}."
            )
        limit = max(MAX_SIZE_CHANGE, self.size_resolution)
        tilted = [n for n, c in zip(names, self.size_change, strict=True) if c > limit]
        if tilted:
            worst = max(c for c in self.size_change if np.isfinite(c))
            remarks.append(
                f"{', '.join(tilted)} left the plane of motion or tilted: apparent size changed by up to "
                f"{worst:.0%}; if the distance to the camera did, measured positions are scaled by as much."
            )
        if self.camera_drift_px > 0.5:
            remarks.append(f"The reference tags drifted by {self.camera_drift_px:.1f} px: fasten the camera.")
        return remarks


def _longest_gap(t: FloatArray, measured: FloatArray) -> float:
    """The longest time without a measurement, also at the start and at the end [s]."""
    if not len(t):
        return 0.0
    seen = np.concatenate([t[:1], t[measured], t[-1:]])
    return float(np.diff(seen).max())


def _max_size_change(sizes: FloatArray) -> float:
    seen = sizes[np.isfinite(sizes)]
    if len(seen) < _SMOOTHING_FRAMES:
        return float("nan")
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(seen, _SMOOTHING_FRAMES), axis=1)
    return float(np.abs(smooth / np.median(seen) - 1).max())

"""How good a tracked motion is: frames that lack, marks that were covered, motion out of the plane."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from eldir.core.records import FloatArray
from eldir.trajectory import Trajectory

OUT_OF_PLANE = 0.05
"""A mark that appears this much larger or smaller than it mostly does has left the plane."""
_SMOOTH = 5  # frames whose median is taken for a mark's size


@dataclass(frozen=True)
class TrackingQuality:
    """Counts and shares; for marks in the order of their names."""

    frames: int
    rate_hz: float
    """One over the median time between frames."""
    dropped_frames: int
    """Frames that lack by the times of those there are."""
    repeated_times: int
    """Frames left out, as they are not later than the one before."""
    repeated_pictures: int
    """Frames whose picture is the one before: the camera or the recorder gave it twice."""
    seen: tuple[float, ...]
    """Share of frames in which each mark was measured."""
    bridged: tuple[float, ...]
    """Share of frames in which it was not, but shortly before and after."""
    longest_gap_s: tuple[float, ...]
    size_change: tuple[float, ...]
    """Greatest change of each mark's apparent size, of its median; NaN if never seen."""
    size_resolution: float
    """What a mark's apparent size differs by for where it lies between pixels, as a part of it."""
    camera_drift_px: float | None
    """How far the fixed tags moved in the picture; None where there were none to watch."""

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        sizes: FloatArray,
        size_resolution: float = 0.0,
        repeated_times: int = 0,
        repeated_pictures: int = 0,
        camera_drift_px: float | None = None,
    ) -> TrackingQuality:
        """`sizes` (T, K): how large each mark appeared, in any unit; NaN where not seen."""
        t = trajectory.times
        gaps = np.diff(t)
        usual = float(np.median(gaps)) if len(gaps) else 0.0
        measured = np.isfinite(trajectory.positions[..., 0]) & ~trajectory.bridged
        return cls(
            frames=len(t),
            rate_hz=1 / usual if usual else 0.0,
            dropped_frames=int(np.round(gaps[gaps > 1.5 * usual] / usual - 1).sum()) if usual else 0,
            repeated_times=repeated_times,
            repeated_pictures=repeated_pictures,
            seen=tuple(measured.mean(axis=0).tolist()),
            bridged=tuple(trajectory.bridged.mean(axis=0).tolist()),
            longest_gap_s=tuple(_longest_gap(t, column) for column in measured.T),
            size_change=tuple(_change(column) for column in sizes.T),
            size_resolution=size_resolution,
            camera_drift_px=camera_drift_px,
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values; what is unknown is null."""

        def plain(value: Any) -> Any:
            if isinstance(value, tuple):
                return [plain(v) for v in value]
            return (round(value, 6) if np.isfinite(value) else None) if isinstance(value, float) else value

        return {name: plain(value) for name, value in asdict(self).items()}

    def remarks(self, names: tuple[str, ...]) -> list[str]:
        """What a reader should know before believing the numbers."""
        said = []
        for name, share, gap in zip(names, self.seen, self.longest_gap_s, strict=True):
            if share < 0.95:
                said.append(f"The camera saw {name} in only {share:.0%} of the frames, not for {gap:.1f} s.")
        if self.dropped_frames:
            said.append(f"{self.dropped_frames} frames lack, by the times of those there are.")
        if self.repeated_times or self.repeated_pictures:
            said.append(
                f"{self.repeated_times} frames repeat a time and are left out, {self.repeated_pictures} "
                "repeat the picture before."
            )
        limit = max(OUT_OF_PLANE, self.size_resolution)
        tilted = [n for n, c in zip(names, self.size_change, strict=True) if c > limit]
        if tilted:
            worst = max(c for c in self.size_change if np.isfinite(c))
            said.append(
                f"Out of the plane: {', '.join(tilted)} changed in apparent size by up to {worst:.0%}, "
                "as much as the distance to the camera; their positions are scaled by that."
            )
        if self.camera_drift_px is not None and self.camera_drift_px > 0.5:
            said.append(f"The fixed tags drifted by {self.camera_drift_px:.1f} px: the camera is not firm.")
        return said


def _longest_gap(t: FloatArray, measured: FloatArray) -> float:
    """The longest time between two sightings, or none from the start or to the end [s]."""
    if not len(t):
        return 0.0
    seen = np.concatenate([t[:1], t[measured], t[-1:]])
    return float(np.diff(seen).max())


def _change(sizes: FloatArray) -> float:
    seen = sizes[np.isfinite(sizes)]
    if len(seen) < _SMOOTH:
        return float("nan")
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(seen, _SMOOTH), axis=1)
    return float(np.abs(smooth / np.median(seen) - 1).max())

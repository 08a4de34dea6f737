"""Logs that cannot tell are refused, each with its reason, before and after a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.dynamics.recording import Recording
from eldir.errors import InputError

_MARKS = 3
_SEEN = 0.5  # of the frames
_MOVED = 2e-3  # least vertical range of the mark that moves most [m]
_EXPLAINED = 0.35  # of the motion may be left unexplained


def require_telling(recordings: Sequence[Recording]) -> None:
    """Refuse too few cycles or marks, cold motors, and a robot that does not move."""
    if not recordings or min(r.cycles for r in recordings) < 2:
        raise InputError(
            "too few cycles to identify from",
            expected="two or more, of which the last is held out",
            found=str(min((r.cycles for r in recordings), default=0)),
        )
    for r in recordings:
        inside = (r.tracked.times >= r.start) & (r.tracked.times <= r.end)
        x = r.tracked.positions[inside]
        share = np.isfinite(x[..., 0]).mean(axis=0) if len(x) else np.zeros(x.shape[1])
        seen = [name for name, s in zip(r.tracked.names, share, strict=True) if s >= _SEEN]
        if len(seen) < _MARKS:
            raise InputError(
                "too few marks to identify from",
                expected=f"{_MARKS} or more that are seen in half of the frames",
                found=", ".join(seen) or "none",
                remedy="light the marks, or clear what hides them",
            )
        if not (r.on > 0).any():
            raise InputError("no motor was ever heated", remedy="check the log's relay states")
        heights = x[:, share >= _SEEN, 1]
        moved = float((np.nanmax(heights, axis=0) - np.nanmin(heights, axis=0)).max())
        if moved < _MOVED:
            raise InputError(
                "the robot hardly moves: its log tells nothing about it",
                expected=f"a mark that rises and falls by {_MOVED * 1e3:.0f} mm",
                found=f"{moved * 1e3:.1f} mm",
                remedy="check supply and springs, or try another gait",
            )


def require_explained(recordings: Sequence[Recording], left: float) -> None:
    """Refuse a fit after which most of the motion is still unexplained: it was another robot."""
    spread = [np.nanstd(r.tracked.positions[..., 1], axis=0) for r in recordings]
    moved = float(np.sqrt(np.nanmean(np.concatenate(spread) ** 2)))
    if left > _EXPLAINED * moved:
        raise InputError(
            "no robot of this design moves like the one that was filmed",
            expected=f"at most {_EXPLAINED * moved * 1e3:.1f} mm unexplained",
            found=f"{left * 1e3:.1f} mm",
            remedy="check the design file, the order of the marks and the wiring",
        )

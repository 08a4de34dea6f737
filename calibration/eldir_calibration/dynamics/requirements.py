"""Films from which a robot cannot be identified are refused, before and after a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eldir.errors import InputError
from eldir_calibration.dynamics.recording import Recording
from eldir_calibration.dynamics.settings import DEFAULT_SETTINGS, IdentificationSettings


def require_informative(
    recordings: Sequence[Recording], settings: IdentificationSettings = DEFAULT_SETTINGS
) -> None:
    """Raise `InputError` for too few cycles or marks, cold motors, and a robot that does not move."""
    if not recordings or min(r.cycles for r in recordings) < settings.least_cycles:
        raise InputError(
            "too few cycles to identify from",
            code="dynamics.too-few-cycles",
            expected=f"{settings.least_cycles} or more, of which the last is held out",
            found=str(min((r.cycles for r in recordings), default=0)),
        )
    for r in recordings:
        inside = (r.tracked.times >= r.start) & (r.tracked.times <= r.end)
        x = r.tracked.positions[inside]
        share = np.isfinite(x[..., 0]).mean(axis=0) if len(x) else np.zeros(x.shape[1])
        seen = [name for name, s in zip(r.tracked.names, share, strict=True) if s >= settings.seen_share]
        if len(seen) < settings.least_marks:
            raise InputError(
                "too few marks to identify from",
                code="dynamics.too-few-marks",
                expected=f"{settings.least_marks} or more, seen in {settings.seen_share:.0%} of the frames",
                found=", ".join(seen) or "none",
                remedy="light the marks, or remove what hides them",
            )
        if not (r.on > 0).any():
            raise InputError(
                "no motor was ever heated",
                code="dynamics.never-heated",
                remedy="check the log's relay states",
            )
        heights = x[:, share >= settings.seen_share, 1]
        moved = float((np.nanmax(heights, axis=0) - np.nanmin(heights, axis=0)).max())
        if moved < settings.least_motion:
            raise InputError(
                "the robot hardly moves, so its log says nothing about its parameters",
                code="dynamics.hardly-moves",
                expected=f"a mark that rises and falls by {settings.least_motion * 1e3:.0f} mm",
                found=f"{moved * 1e3:.1f} mm",
                remedy="check supply and springs, or try another gait",
            )


def require_explained(
    recordings: Sequence[Recording], left: float, settings: IdentificationSettings = DEFAULT_SETTINGS
) -> None:
    """Raise `InputError` for a fit that leaves too much of the motion, root mean square `left` [m]: it was
    another robot."""
    spread = [np.nanstd(r.tracked.positions[..., 1], axis=0) for r in recordings]
    moved = float(np.sqrt(np.nanmean(np.concatenate(spread) ** 2)))
    allowed = settings.unexplained_share * moved
    if left > allowed:
        raise InputError(
            "no robot of this design moves like the one that was filmed",
            code="dynamics.unexplained",
            expected=f"at most {allowed * 1e3:.1f} mm unexplained",
            found=f"{left * 1e3:.1f} mm",
            remedy="check the design file, the order of the marks and the wiring",
        )

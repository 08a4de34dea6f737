"""Detects that the camera moved during a run, by the fixed tags."""

from __future__ import annotations

import numpy as np

from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir_hardware.camera.plane import Image, Plane, TagBoard
from eldir_hardware.camera.tags import edges_at, locate_tags

MOVED = 2.0
"""The camera counts as moved if the median shift of the tags is larger than this [px]."""
_EVERY = 2.0  # [s]
_LEAST = 3


class DriftWatch:
    """Compares centres of tags with the calibrated plane; neither ink nor exposure moves a centre."""

    def __init__(self, plane: Plane, board: TagBoard):
        self._board = board
        corners = plane.to_pixels(board.corners)
        self._corners = dict(zip(board.ids, corners, strict=True))
        self._due = -np.inf
        self.worst = 0.0
        """Greatest median shift of the tags so far [px]."""

    def look(self, image: Image, t: float) -> None:
        """Check a frame taken at t [s], every other second. Raises `InputError` if the camera has moved."""
        if t < self._due:
            return
        self._due = t + _EVERY
        shifts = self._shifts(edges_at(image, self._corners))
        if len(shifts) < len(self._corners) / 2 or max(shifts) > MOVED:  # not where they were: look for them
            shifts = self._shifts(locate_tags(image, self._board))
        if len(shifts) < _LEAST:
            return
        shift = float(np.median(shifts))
        self.worst = max(self.worst, shift)
        if shift > MOVED:
            raise InputError(
                f"the camera has moved since its plane was calibrated, at {t:.1f} s",
                code="camera.moved",
                expected=f"the fixed tags within {MOVED:g} px of their positions",
                found=f"{shift:.1f} px off",
                remedy="fasten the camera; calibrate the plane again from this recording (--tags)",
            )

    def _shifts(self, seen: dict[int, FloatArray]) -> list[float]:
        """How far the centre of each tag is from its place [px]."""
        return [float(np.hypot(*(c.mean(axis=0) - self._corners[i].mean(axis=0)))) for i, c in seen.items()]

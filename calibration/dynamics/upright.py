"""Whether a robot fell, from its marks alone."""

from __future__ import annotations

import numpy as np

from eldir.built.walking import TOPPLED
from eldir.core.records import FloatArray
from eldir.trajectory import Trajectory

_LEAST = 3  # marks that determine the rotation of the body; two do not
_LONG = 1.0  # a robot turned for this time in all lies; less may be a mistaken mark [s]


def stayed_upright(rest: FloatArray, tracked: Trajectory) -> bool:
    """Whether marks that at `rest` (K, 2) [m] lie there were never turned as by a fall.

    The rotation is the one of `eldir.built.walking.rotation`, of the marks that are seen.
    """
    seen = np.isfinite(tracked.positions[..., 0])
    enough = seen.sum(axis=1) >= _LEAST
    there = seen[enough][..., None]
    now = np.where(there, tracked.positions[enough], 0.0)
    drawn = np.where(there, rest, 0.0)
    number = there.sum(axis=1, keepdims=True)
    a, b = (there * (x - x.sum(axis=1, keepdims=True) / number) for x in (drawn, now))
    cross = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)
    turned = np.abs(np.arctan2(cross, (a * b).sum(axis=(1, 2))))
    step = np.diff(tracked.times, append=tracked.times[-1:])[enough]
    return bool(step[turned > TOPPLED].sum() <= _LONG)

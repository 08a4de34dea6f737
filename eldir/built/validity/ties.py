"""Ties: times in which it is open which of a robot's outer feet slips.

A robot that pushes its feet apart slides on the foot that grips less. Where both outer feet bear about the
same load, small differences of friction decide. Predictions of such a walk are worth little: where ties take
42 % of the sliding and more, another simulation of the same robot differed by 0.14 to 0.35 body lengths,
sometimes in sign; where they take 25 % or less, by 0.05 (docs/reference/second-physics.md).
"""

from __future__ import annotations

import numpy as np

from eldir.built.robot import BuiltRobot
from eldir.core.records import FloatArray

TIED = 0.3
"""A larger share of ties makes a prediction doubtful."""
_EVEN = 0.05  # of the load: both outer feet bear 45 to 55 per cent
_CONTACT = 1e-4  # heights up to this count as on the table [m]


def described(share: float) -> str:
    """A share of ties in words."""
    words = f"ties: in {share:.0%} of the feet's sliding both outer feet bear about the same load"
    if share > TIED:
        return f"{words}; chance decides which one slips, so this prediction is doubtful"
    return f"{words} (above {TIED:.0%} a prediction is doubtful)"


def tie_share(robot: BuiltRobot, positions: FloatArray) -> float:
    """Share of the feet's sliding during which both outer feet bear 45 to 55 per cent of the load; 0 for a
    robot that does not slide.

    `positions` [m], shape (T, M, 2): a few instants in each second. The loads are those of a body at rest on
    its two outer feet (law of the lever).
    """
    on_table = positions[..., 1] < _CONTACT
    touching = on_table[:-1] & on_table[1:]
    x = (positions[:-1, :, 0] + positions[1:, :, 0]) / 2
    slid = np.where(touching, np.abs(np.diff(positions[..., 0], axis=0)), 0.0).sum(axis=1)
    rear = np.where(touching, x, np.inf).min(axis=1)
    front = np.where(touching, x, -np.inf).max(axis=1)
    stands = front > rear
    middle = x @ robot.masses / robot.masses.sum()
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (middle - rear) / (front - rear)
    tied = stands & (np.abs(share - 0.5) < _EVEN)
    total = slid[stands].sum()
    return float(slid[tied].sum() / total) if total > 0 else 0.0

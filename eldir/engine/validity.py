"""How far the result of a simulation can be trusted: its status, the speed from which on a robot has
diverged, and flags for gradients.

`docs/reference/accuracy.md` says how the numbers were measured. Nothing heavy is imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from eldir.core.records import BoolArray, FloatArray

if TYPE_CHECKING:
    from eldir.morphology import Bodies
    from eldir.physics import Physics
    from eldir.scene import Scene

OK, REFUSED, NO_GRADIENT = -1, -2, -3
"""Status of a robot that completed all steps, of one for which the scene's step is too large, and of one that
completed all steps but whose gradient overflowed or is not a number. Otherwise the status is the step at
which the robot diverged."""
MAX_SQUARE = 3e38
"""A gradient overflows where its squared norm is not smaller, in either precision: float32 ends there."""
_CHAOTIC_GROWTH = 3e3
"""Of gradients that have grown more, 85 % are not the slope of the loss over 1e-5 of the weights, of the
others 7 %."""
_MAX_RANDOM_ROUNDING, _MAX_EVEN_ROUNDING = 3e-3, 1e-3
"""Estimated relative errors. Below them, no float32 gradient of those measured was off by more than 5 %."""
_FASTEST = 1e6
"""No mass may be faster [m/s], so that its square is a number in float32."""


def max_speeds(bodies: Bodies, scene: Scene, physics: Sequence[Physics]) -> FloatArray:
    """The speed from which on each robot has diverged [m/s], shape (n,).

    No mass may move by a spring's length in one step: the mean of its body's springs, as they are placed or
    at rest, whichever is less. A mass that lands faster is not stopped by its neighbours but thrown through
    them, and gains energy out of nothing. In free flight nothing lands, and what all masses of a body have
    in common, its initial speed and that of its fall, comes in addition."""
    a, b = bodies.springs.T
    x, counts = bodies["positions"], np.diff(bodies.spring_at)
    placed, rest = (
        np.bincount(bodies.of_spring, lengths, minlength=len(bodies)) / np.maximum(counts, 1)
        for lengths in (
            np.linalg.norm(x[a] - x[b], axis=1),
            np.concatenate([own.rest_lengths for own in physics]),
        )
    )
    speeds: FloatArray = np.minimum(placed, rest) / scene.dt
    if scene.contact == "none":
        duration = scene.steps * scene.dt
        speeds += [
            np.linalg.norm(own.velocities, axis=1).max() + abs(own.gravity) * duration for own in physics
        ]
    return np.minimum(speeds, _FASTEST)


def is_chaotic(growth: FloatArray) -> BoolArray:
    """Whether chaos dominates a gradient: it is the slope of the loss only over a tiny change of the
    weights, and says nothing about an update. `growth` is how many times larger the gradient of a position
    became in the reverse sweep than at its beginning, any shape."""
    return ~(growth <= _CHAOTIC_GROWTH)  # NaN too


def is_rounded(growth: FloatArray, scene: Scene) -> BoolArray:
    """Whether rounding may change a gradient by a per cent or more, in this scene's precision and steps.

    Each step rounds anew. The errors of n steps mostly add up to the square root of n, and grow as the
    gradient; where they are all of one sign, to n, because a step so short moves a mass by little more than
    what is rounded."""
    unit = np.finfo(np.float32 if scene.precision == "f32" else np.float64).eps / 2
    random = ~(unit * np.sqrt(scene.steps) * growth <= _MAX_RANDOM_ROUNDING)
    return random | (growth != 0) & (unit * scene.steps > _MAX_EVEN_ROUNDING)

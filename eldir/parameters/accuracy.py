"""Which step a wanted accuracy takes, as `eldir benchmark accuracy` found."""

from __future__ import annotations

import numpy as np

from eldir.errors import InputError

_STIFFNESS = 3e4  # at which the steps were measured [N/m]
_LARGEST_STEP = ((3e-3, 1.6e-3), (1e-3, 8e-4), (3e-4, 3.2e-4), (1e-4, 1e-4), (4e-5, 5e-5))
"""Error [m] and the second-order scheme's step [s] at which nine robots in ten stay well below it."""


def largest_step(error: float, stiffness: float) -> float:
    """Of the second-order scheme in float32 [s], for which nine robots in ten were at most `error` [m] (root
    mean square over masses) from the exact motion after one second. Springs stiffer than the paper's take
    shorter steps; `stiffness` in N/m.
    """
    steps = [step for least, step in _LARGEST_STEP if least <= error]
    if not steps:
        raise InputError(
            "no setting is known for so small an error",
            expected=f"at least {_LARGEST_STEP[-1][0]:g} m",
            found=f"{error:g}",
        )
    return steps[0] * min(1.0, float(np.sqrt(_STIFFNESS / stiffness)))

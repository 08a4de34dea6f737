"""Which step and integrator a wanted accuracy takes, as `eldir benchmark accuracy` found."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from eldir.errors import InputError

if TYPE_CHECKING:
    from eldir.scene import Scene

_STIFFNESS = 3e4  # at which the steps were measured [N/m]
_LARGEST_STEP = ((3e-3, 1.6e-3), (1e-3, 8e-4), (3e-4, 3.2e-4), (1e-4, 1e-4), (4e-5, 5e-5))
"""Error [m] and the second-order scheme's step [s] at which nine robots in ten stay well below it."""


def for_error(scene: Scene, error: float) -> Scene:
    """The scene with the integrator, precision and longest step measured for which nine robots in ten are at
    most `error` [m] (root mean square over masses) from the exact motion after one second; with as many steps
    as last as long. Springs stiffer than the paper's take shorter steps.
    """
    if scene.built is not None:
        raise InputError(
            "Scene.for_error knows the learning scenes only",
            expected="a scene such as 'paper'",
            found=repr(scene.name),
            remedy="leave the step to eldir.driving.drive, which takes the largest stable one",
        )
    steps = [step for least, step in _LARGEST_STEP if least <= error]
    if not steps:
        raise InputError(
            "no setting is known for so small an error",
            expected=f"at least {_LARGEST_STEP[-1][0]:g} m",
            found=f"{error:g}",
        )
    largest = min(steps[0] * min(1.0, float(np.sqrt(_STIFFNESS / scene.stiffness))), scene.dt)
    parts = int(np.ceil(scene.dt / largest * (1 - 1e-12)))
    return scene.replace(
        integrator="second-order", precision="f32", dt=scene.dt / parts, steps=scene.steps * parts
    )


class ForError:
    """`Scene.for_error(1e-4)` is the paper's scene, `scene.for_error(1e-4)` another one, made accurate."""

    def __get__(self, scene: Scene | None, kind: type[Scene]) -> partial[Scene]:
        return partial(for_error, scene if scene is not None else kind())

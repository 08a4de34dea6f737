"""The robot on the virtual rig, moved by the physics that the rig file names."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Literal

from eldir.core.records import FloatArray
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from hardware.virtual.rig import DrivenBody

Physics = Literal["eldir", "mujoco"]


def virtual_body(
    physics: Physics,
    morphology: Morphology,
    seed: int,
    springs: SpringParameters,
    ballast: FloatArray,
    built: BuiltParameters | None = None,
) -> DrivenBody:
    """The robot of a design, which deviates from the nominal one by the seed.

    `ballast` [kg] on each mass, both faces together, shape (M,); `built`: parameters of the robot, else by
    `seed`. Raises `MissingDependencyError` where the physics is not installed.
    """
    if physics == "mujoco":
        from hardware.virtual.mujoco_body import MujocoBody

        return MujocoBody(morphology, seed, springs, ballast, built)
    from hardware.virtual.body import BuiltBody

    return BuiltBody(morphology, seed, springs, ballast / 2, built)


def best_physics() -> Physics:
    """MuJoCo where it is installed: the prediction and the filmed robot then share no simulation."""
    return "mujoco" if find_spec("mujoco") else "eldir"


def physics_name(physics: Physics) -> str:
    """The program that moves the robot, with its version."""
    if physics == "mujoco":
        from hardware.virtual.mujoco_body import engine_name

        return engine_name()
    from eldir.core.version import __version__

    return f"eldir {__version__}"

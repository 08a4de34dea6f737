"""The robot on the virtual rig, moved by the physics that the rig file names."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from typing import Literal

import numpy as np

from eldir.core.records import FloatArray
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_hardware.virtual.rig import DrivenBody

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
        from eldir_hardware.virtual.mujoco_body import MujocoBody

        return MujocoBody(morphology, seed, springs, ballast, built)
    from eldir_hardware.virtual.body import BuiltBody

    return BuiltBody(morphology, seed, springs, ballast / 2, built)


def best_physics() -> Physics:
    """MuJoCo where it is installed: the prediction and the filmed robot then share no simulation."""
    return "mujoco" if find_spec("mujoco") else "eldir"


def physics_name(physics: Physics) -> str:
    """The program that moves the robot, with its version."""
    if physics == "mujoco":
        from eldir_hardware.virtual.mujoco_body import engine_name

        return engine_name()
    from eldir.core.version import __version__

    return f"eldir {__version__}"


def far_from(nominal: RobotParameters, seed: int) -> RobotParameters:
    """A robot far from the nominal one, which an identification on a virtual rig has to find: springs and
    friction 10 to 50 per cent off, everything else as printed robots differ.

    Free lengths are off by 10 to 30 per cent and the current by 10 to 25: with more, the robot would fall or
    stand still.
    """
    rng = np.random.default_rng([seed, 4])

    def off(least: float, most: float) -> float:
        return float(1 + rng.choice([-1, 1]) * rng.uniform(least, most))

    built, springs = nominal.printed, nominal.springs
    soft, apart = off(0.1, 0.5), float(rng.uniform(0.9, 1.1))
    built = replace(
        built.perturbed(rng),
        friction=built.friction * off(0.1, 0.5),
        cold_stiffness=built.cold_stiffness * soft,
        hot_stiffness=built.hot_stiffness * soft * apart,
    )
    springs = replace(
        springs.perturbed(rng),
        cold_length=springs.cold_length * off(0.1, 0.3),
        hot_length=springs.hot_length * off(0.1, 0.2),
        current_limit=springs.current_limit * off(0.1, 0.25),
        convection_fan=springs.convection_fan * off(0.1, 0.4),
    )
    return RobotParameters(built, springs)

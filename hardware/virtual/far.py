"""A robot far from the nominal one, which an identification on a virtual rig has to find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eldir.parameters.robot import RobotParameters


def far_from(nominal: RobotParameters, seed: int) -> RobotParameters:
    """Springs and friction 10 to 50 per cent off, everything else as printed robots differ.

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

"""Scenes that a film identified, and what the film says of their gait."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eldir.built.gait import FilmedGait, Gait
from eldir.built.scene import PrintedScene
from eldir.design import Design
from eldir.parameters.robot import RobotParameters
from tests.calibration.dynamics.hidden_rigs import SOFT

WALKED = Gait(20.0, np.array([0.0, 0.25]), np.array([0.3, 0.3]))


def scene_of(
    design: Design,
    *films: FilmedGait,
    robot: RobotParameters = SOFT,
    spread: float = 0.1,
    model_fits: bool = True,
) -> PrintedScene:
    """As `eldir calibrate dynamics` would write it, friction and hot length uncertain."""
    scene = PrintedScene.of(robot, ("friction", "hot_length"), spread**2 * np.eye(2))
    return replace(scene, model_fits=model_fits, body=design.body, filmed_gaits=films)


def film(walked: float, gait: Gait = WALKED, upright: bool = True, lost: float | None = None) -> FilmedGait:
    return FilmedGait.of(gait, walked, not upright, 5, "log.mcap", lost)

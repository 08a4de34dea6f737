"""The ground of a run: flat, or rugged with one of three tilts (paper, Sect. Terrain)."""

from __future__ import annotations

import numpy as np

from eldir.evolution.defaults import Ground
from eldir.scene import Scene
from eldir.terrain import Terrain

TILTS: dict[Ground, float] = {"level": 0.0, "incline": 0.2, "decline": -0.2}
"""Tilt of each kind of rugged ground, as `Terrain.rugged` takes it."""


def scene_on(ground: Ground, seed: int) -> Scene:
    """The paper's scene on this ground. Rugged ground is drawn from the seed of the run."""
    scene = Scene.preset("paper")
    if ground == "flat":
        return scene
    # A key of its own: the robots' seeds have keys of two numbers, the generations' of one.
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, 0, 0)))
    return scene.replace(terrain=Terrain.rugged(rng, TILTS[ground]))

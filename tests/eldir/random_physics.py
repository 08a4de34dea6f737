"""Physical parameters of a robot's own, drawn at random."""

import numpy as np

from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene
from eldir.terrain import Terrain

PAPER = Scene.preset("paper").replace(precision="f64")
RUGGED = PAPER.replace(terrain=Terrain.rugged(np.random.default_rng(2)))


def drawn(body: Morphology, scene: Scene, seed: int) -> Physics:
    """Everything is different from what the scene and the body say."""
    rng = np.random.default_rng(seed)
    springs, masses = len(body.springs), len(body.positions)
    own = Physics.of(body, scene).replace(
        stiffness=scene.stiffness * rng.uniform(0.4, 1.0, springs),
        rest_lengths=body.rest_lengths * rng.uniform(0.95, 1.05, springs),
        velocities=rng.normal(0, 0.2, (masses, 2)),
        damping=scene.damping * rng.uniform(0.5, 1.5) + 1.0,
        gravity=scene.gravity * rng.uniform(0.5, 1.5),
    )
    return own if scene.contact in ("no-slip", "none") else own.replace(friction=rng.uniform(0.2, 0.8))

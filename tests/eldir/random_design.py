"""A design with a random body and controller."""

import numpy as np

from eldir.controller import Controller
from eldir.design import Design
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.scene import Scene
from eldir.terrain import Terrain


def make_design(seed: int = 0, lattice: Lattice | None = None) -> Design:
    lattice = lattice or Lattice(6, 11)
    rng = np.random.default_rng(seed)
    genotype = random_genotypes(lattice, 1, rng, max_active=2)[0]
    body = develop(lattice, genotype)
    scene = Scene.preset("paper").replace(terrain=Terrain.rugged(rng, 0.2))
    controller = Controller.random(len(body.positions), body.motors, rng)
    return Design(lattice, genotype, controller, scene, provenance={"seed": seed})

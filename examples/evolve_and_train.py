"""Train the controllers of ten random robots by gradient descent, and evolve them for two generations."""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import eldir

lattice = eldir.Lattice(rows=6, columns=11)
scene = eldir.Scene.preset("paper")

# Learning alone: 35 updates for each of ten random robots.
genotypes = eldir.random_genotypes(lattice, 10, np.random.default_rng(1))
bodies = [eldir.develop(lattice, g) for g in genotypes]
result = eldir.learn(bodies, scene, iterations=35, seed=1)
walked = result.displacements  # forward displacement of the centre of mass [m], shape (10, 36)
for body, before, best in zip(bodies, walked[:, 0], walked.max(axis=1), strict=True):
    print(f"{len(body.springs):3d} springs: {before:+.3f} m before learning, {best:+.3f} m after")

# Evolution and learning: the better half of parents and offspring survives.
config = eldir.EvolutionConfig(
    lattice=lattice, population=10, generations=2, iterations=10, seed=1, scene=scene
)
run = eldir.evolve(config, Path(mkdtemp()) / "run")
print(f"the run is in {run.path}: continue with `eldir status` or `eldir analyse`")

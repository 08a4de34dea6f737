"""Train ten random robots on rugged ground; plot what they learn, and how the best one walks."""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from matplotlib.figure import Figure

import eldir

rng = np.random.default_rng(1)
lattice = eldir.Lattice(rows=6, columns=11)
terrain = eldir.Terrain.rugged(rng, tilt=0.0)  # 0: level on average; positive rises, negative falls
scene = eldir.Scene.preset("paper").replace(terrain=terrain, contact="friction")

genotypes = eldir.random_genotypes(lattice, 10, rng)
bodies = [eldir.develop(lattice, g) for g in genotypes]
result = eldir.learn(bodies, scene, iterations=35, seed=1)
walked = result.displacements  # forward displacement of the centre of mass [m], shape (10, 36)
best = int(walked.max(axis=1).argmax())
rollout = eldir.simulate_one(bodies[best], result.controllers[best], scene)
centre = rollout.positions.mean(axis=1)  # shape (steps + 1, 2)

figure = Figure(figsize=(9, 3.6), layout="constrained")
learning, way = figure.subplots(1, 2)
learning.plot(walked.T)
learning.set(xlabel="update", ylabel="forward displacement [m]", title="ten robots learn")
x = np.linspace(centre[:, 0].min() - 0.2, centre[:, 0].max() + 0.2, 300)
way.plot(x, terrain.height(x), color="0.4", label="ground")
way.plot(*centre.T, label="centre of mass of the best")
way.set(xlabel="x [m]", ylabel="y [m]", title=f"robot {best} walks {walked[best].max():.2f} m")
way.legend()
picture = Path(mkdtemp()) / "rugged_ground.png"
figure.savefig(picture)
print(f"best: robot {best}, {walked[best, 0]:+.3f} m before learning, {walked[best].max():+.3f} m after")
print(f"see {picture}")

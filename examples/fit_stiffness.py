"""Find a robot's stiffness and damping from an observed motion, by gradients through the simulation.

The robot flies freely and briefly: where feet strike the ground, the fit can end in another minimum.
"""

import numpy as np

import eldir
from eldir.physics import Physics
from eldir.training.fitting import fit_physics

rng = np.random.default_rng(3)
lattice = eldir.Lattice(rows=6, columns=11)
(genotype,) = eldir.random_genotypes(lattice, 1, rng)
body = eldir.develop(lattice, genotype)
controller = eldir.Controller.random(len(body.positions), body.motors, rng)
scene = eldir.Scene.preset("paper").replace(steps=100, precision="f64", contact="none")

# The observed robot: 20 % stiffer, 10 % less damped; a camera with 0.1 mm of noise.
nominal = Physics.of(body, scene)
real = nominal.replace(stiffness=1.2 * nominal.stiffness, damping=0.9 * nominal.damping)
rollout = eldir.simulate_one(body, controller, scene, real)
observed = rollout.positions + 1e-4 * rng.standard_normal(rollout.positions.shape)

found = fit_physics(body, controller, scene, observed, ["stiffness", "damping"])
for name, factor, error in zip(["stiffness", "damping"], found.factors, found.errors, strict=True):
    print(f"{name}: {factor:.5f} +- {factor * error:.5f} times the nominal value")
assert np.allclose(found.factors, [1.2, 0.9], atol=1e-3)
print(f"root mean square distance {found.distance * 1e3:.3f} mm")

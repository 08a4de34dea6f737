"""The gradient of the loss with respect to a controller, checked by central differences."""

import numpy as np

import eldir

rng = np.random.default_rng(2)
lattice = eldir.Lattice(rows=6, columns=11)
(genotype,) = eldir.random_genotypes(lattice, 1, rng)
body = eldir.develop(lattice, genotype)
controller = eldir.Controller.random(len(body.positions), body.motors, rng)
scene = eldir.Scene.preset("paper").replace(steps=200, precision="f64")

losses, gradients = eldir.loss_and_gradient([body], [controller], scene)
slope = gradients[0].flat

# Walk along a random direction of all weights: the difference must be the gradient's component.
direction = rng.standard_normal(len(slope))
direction /= np.linalg.norm(direction)
step = 1e-6
ends = [controller.shaped(controller.flat + s * step * direction) for s in (1, -1)]
ahead, behind = (rollout.loss for rollout in eldir.simulate([body, body], ends, scene))
difference = (ahead - behind) / (2 * step)

print(f"loss {losses[0]:+.6f} m, {len(slope)} weights")
print(f"gradient along the direction {slope @ direction:+.9e}")
print(f"central difference           {difference:+.9e}")
assert np.isclose(slope @ direction, difference, rtol=1e-5)

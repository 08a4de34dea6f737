"""Two rollouts in one loss: a controller that walks far both uphill and downhill."""

import jax
import jax.numpy as jnp
import numpy as np

import eldir
import eldir.jax

rng = np.random.default_rng(3)
lattice = eldir.Lattice(rows=6, columns=11)
(genotype,) = eldir.random_genotypes(lattice, 1, rng)
body = eldir.develop(lattice, genotype)
controller = eldir.Controller.random(len(body.positions), body.motors, rng)
level = eldir.Scene.preset("paper").replace(steps=500)
slopes = [
    level.replace(terrain=eldir.Terrain.from_segments([-10.0], [tilt], [0.1 - 0.25 * tilt]))
    for tilt in (0.05, -0.05)
]


def walks(controller: eldir.Controller) -> list[jax.Array]:
    """Forward displacements uphill and downhill [m]."""
    rollouts = [eldir.jax.simulate_one(body, controller, scene) for scene in slopes]
    return [jnp.mean(r.positions[-1, :, 0] - r.positions[0, :, 0]) for r in rollouts]


def loss(controller: eldir.Controller) -> jax.Array:
    return -jnp.minimum(*walks(controller))


for update in range(20):
    value, gradient = jax.value_and_grad(loss)(controller)
    length = np.linalg.norm(gradient.flat)
    controller = controller.shaped(controller.flat - 0.2 * gradient.flat / length)
    print(f"update {update}: at least {-value:+.3f} m")
up, down = walks(controller)
print(f"uphill {up:+.3f} m, downhill {down:+.3f} m")

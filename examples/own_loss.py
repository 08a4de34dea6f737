"""Your own loss on a rollout, written with JAX: train a robot to lift its highest mass.

JAX differentiates the loss, the engine the simulation.
"""

import jax.numpy as jnp
import numpy as np

import eldir
from eldir.training.differentiable import RolloutArrays

rng = np.random.default_rng(5)
lattice = eldir.Lattice(rows=6, columns=11)
(genotype,) = eldir.random_genotypes(lattice, 1, rng)
body = eldir.develop(lattice, genotype)
controller = eldir.Controller.random(len(body.positions), body.motors, rng)
scene = eldir.Scene.preset("paper").replace(steps=300)
top = int(body.positions[:, 1].argmax())


def loss(rollout: RolloutArrays) -> jnp.ndarray:
    """Minus the mean height of the top mass [m], and a little for the effort of the motors."""
    return -jnp.mean(rollout.positions[:, top, 1]) + 1e-3 * jnp.mean(rollout.activations**2)


differentiate = eldir.value_and_grad(loss)
for update in range(6):
    found = differentiate([body], [controller], scene)
    print(f"update {update}: loss {found.losses[0]:+.4f}")
    gradient = found.controllers[0].flat
    controller = controller.shaped(controller.flat - 0.2 * gradient / np.linalg.norm(gradient))

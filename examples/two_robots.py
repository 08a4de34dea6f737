"""Two rollouts in one loss: a controller that walks far with soft springs and with stiff ones."""

import jax
import jax.numpy as jnp
import numpy as np

import eldir
import eldir.jax
from eldir.physics import Physics

rng = np.random.default_rng(3)
lattice = eldir.Lattice(rows=6, columns=11)
(genotype,) = eldir.random_genotypes(lattice, 1, rng)
body = eldir.develop(lattice, genotype)
controller = eldir.Controller.random(len(body.positions), body.motors, rng)
scene = eldir.Scene.preset("paper").replace(steps=500)
nominal = Physics.of(body, scene)
springs = [nominal.replace(stiffness=factor * nominal.stiffness) for factor in (0.7, 1.3)]


def walks(controller: eldir.Controller) -> list[jax.Array]:
    """Forward displacements with soft and with stiff springs [m]."""
    rollouts = eldir.jax.simulate([body, body], [controller, controller], scene, springs)
    return [jnp.mean(r.positions[-1, :, 0] - r.positions[0, :, 0]) for r in rollouts]


def loss(controller: eldir.Controller) -> jax.Array:
    """Minus the shorter walk [m]."""
    return -jnp.minimum(*walks(controller))


for update in range(12):
    value, gradient = jax.value_and_grad(loss)(controller)
    print(f"update {update}: at least {-value:+.3f} m")
    length = np.linalg.norm(gradient.flat)
    controller = controller.shaped(controller.flat - 0.2 * gradient.flat / length)
soft, stiff = walks(controller)
print(f"soft {soft:+.3f} m, stiff {stiff:+.3f} m")

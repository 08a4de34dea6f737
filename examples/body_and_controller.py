"""Rest lengths and stiffness of every spring learn together with the controller, by gradients.

Each spring may be up to 10 % longer or shorter than in its lattice, and up to twice as stiff or soft: the
parameters are numbers without bounds, and tanh keeps the springs within them.
"""

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
scene = eldir.Scene.preset("paper").replace(steps=500, large_step="subdivide")
nominal = Physics.of(body, scene)
none = jnp.zeros(len(body.springs))
parameters = (eldir.Controller.random(len(body.positions), body.motors, rng), none, none)


def loss(parameters: tuple) -> jax.Array:
    """Minus the forward displacement [m]."""
    controller, longer, stiffer = parameters
    physics = {
        "rest_lengths": nominal.rest_lengths * (1 + 0.1 * jnp.tanh(longer)),
        "stiffness": nominal.stiffness * 2 ** jnp.tanh(stiffer),
    }
    x = eldir.jax.simulate_one(body, controller, scene, physics).positions
    return -jnp.mean(x[-1, :, 0] - x[0, :, 0])


for update in range(12):
    value, gradient = jax.value_and_grad(loss)(parameters)
    print(f"update {update}: walks {-value:+.3f} m")
    parameters = jax.tree.map(lambda p, g: p - 0.1 * g / (jnp.linalg.norm(g) + 1e-9), parameters, gradient)

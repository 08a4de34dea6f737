"""Rollouts as functions that JAX differentiates, for losses of several rollouts or of your own parameters.

    import eldir.jax
    import jax

    def loss(controller):
        up, down = (eldir.jax.simulate_one(body, controller, scene).positions for scene in (rising, falling))
        return abs(up[-1, :, 0].mean() - down[-1, :, 0].mean())

    gradient = jax.grad(loss)(controller)  # a Controller

`Controller` and `Physics` are pytrees: `jax.grad`, `jax.tree.map` and optimisers take and return them. JAX
calls the engine with numbers, so these functions work within `jax.grad`, `jax.value_and_grad` and `jax.vjp`,
not within `jax.jit` or `jax.vmap`; compile what comes before and after them. Needs JAX:
pip install 'eldir[jax]'.
"""

from eldir.jax.rollouts import simulate as simulate
from eldir.jax.rollouts import simulate_one as simulate_one

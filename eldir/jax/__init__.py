"""Rollouts as functions that JAX differentiates: `eldir.jax.rollouts`. The import needs JAX.

Not here: the loss of one rollout, which needs no function of JAX around the simulation
(`eldir.training.own_loss`).
"""

from eldir.jax.rollouts import simulate as simulate
from eldir.jax.rollouts import simulate_one as simulate_one

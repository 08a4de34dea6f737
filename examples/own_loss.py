"""Your own loss on a rollout: train a robot to lift its highest mass, by the engine's reverse sweep.

A loss is a function of the positions. Its derivatives with respect to them (the cotangents) go in, and the
gradient with respect to the controller comes out.
"""

import numpy as np

import eldir
from eldir.training.gradients import motion_gradient

rng = np.random.default_rng(5)
lattice = eldir.Lattice(rows=6, columns=11)
(genotype,) = eldir.random_genotypes(lattice, 1, rng)
body = eldir.develop(lattice, genotype)
controller = eldir.Controller.random(len(body.positions), body.motors, rng)
scene = eldir.Scene.preset("paper").replace(steps=300)
top = int(body.positions[:, 1].argmax())


def loss(positions: np.ndarray) -> tuple[float, np.ndarray]:
    """Minus the mean height of the top mass [m], and its cotangents, shape (T + 1, M, 2)."""
    cotangents = np.zeros_like(positions)
    cotangents[:, top, 1] = -1 / len(positions)
    return -float(positions[:, top, 1].mean()), cotangents


for update in range(6):
    (rollout,) = eldir.simulate([body], [controller], scene)
    value, cotangents = loss(rollout.positions)
    print(f"update {update}: mean height {-value:.4f} m")
    gradient = motion_gradient([body], [controller], scene, cotangents=[cotangents]).controllers[0].flat
    controller = controller.shaped(controller.flat - 0.2 * gradient / np.linalg.norm(gradient))

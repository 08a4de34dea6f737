"""Gradients with respect to physics: converted from the kernel's quantities to the physical parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from eldir.core.records import FloatArray
from eldir.engine.aligned import aligned
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels import layout
from eldir.engine.pack import Batch, dtype
from eldir.morphology import offsets
from eldir.physics import Physics
from eldir.scene import Scene


def pack_cotangents(
    cotangents: Sequence[FloatArray] | None, batch: Batch, scene: Scene
) -> tuple[NDArray, NDArray[np.int32]]:
    """Cotangents in the kernel's layout, and where each robot's begin. `cotangents` are gradients with
    respect to the positions of all states, (T + 1, M, 2) for each robot.

    Where the kernel's positions are half a step ahead, a state's position is the mean of two of them.
    """
    if cotangents is None:
        return aligned(layout.LANES, dtype(scene)), offsets([0] * len(batch.sizes))
    at = offsets([2 * n.cells * (scene.steps + 1) for n in batch.sizes])
    flat = aligned(int(at[-1]), dtype(scene))
    for r, (given, n, grid) in enumerate(zip(cotangents, batch.sizes, batch.grids, strict=True)):
        mine = given.copy()
        if scene.integrator == "second-order":
            mine[0] = 0  # where a robot begins depends on nothing
            mine[1:] *= 0.5
            mine[:-1] += mine[1:]
        states = flat[at[r] : at[r + 1]].reshape(scene.steps + 1, 2, n.cells)
        states[:, :, grid.cell] = mine.transpose(0, 2, 1)
    return flat, at


def physics_gradients(
    slopes: NDArray, slopes_at: NDArray[np.int32], batch: Batch, scene: Scene, physics: Sequence[Physics]
) -> list[Physics]:
    """Gradients with respect to each robot's parameters, from those with respect to decay, gravity and
    stiffness of one step."""
    found = []
    for first, n, grid, own in zip(slopes_at[:-1], batch.sizes, batch.grids, physics, strict=True):
        values = slopes[first : first + n.slope_values].astype(np.float64)
        counts = np.cumsum([FAMILIES * n.cells, FAMILIES * n.cells, 2 * n.cells])
        stiffness, rest, velocity, scalars = np.split(values, counts)
        decay, gravity, friction = (float(s) for s in scalars.reshape(3, -1).sum(axis=1))
        spring = grid.family * n.cells + grid.first
        by_stiffness = stiffness[spring]
        scheme, slope = scene.scheme_at(own.damping), scene.scheme_slope(own.damping)
        found.append(
            Physics(
                stiffness=scheme.force * by_stiffness,
                rest_lengths=rest[spring],
                velocities=velocity.reshape(2, -1)[:, grid.cell].T,
                damping=slope.decay * decay
                + slope.gravity * own.gravity * gravity
                + slope.force * float(own.stiffness @ by_stiffness),
                gravity=scheme.gravity * gravity,
                friction=friction,
            )
        )
    return found

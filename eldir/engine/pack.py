"""Robots as the kernel's flat arrays, and back. The arrays are ragged and padded only to whole vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike, NDArray

from eldir.controller import CPGS, HIDDEN, Controller
from eldir.core.records import FloatArray
from eldir.engine.aligned import aligned
from eldir.engine.grid import FAMILIES, Grid, place_on_grid
from eldir.engine.kernels import layout
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene

ORIGIN = np.array([0.25, 0.1])
"""Origin of the kernel's coordinates [m]: under the middle of a robot on flat ground. Float32 is finest
near 0, and what is lost of positions is what gradients lose (docs/reference/accuracy.md)."""


@dataclass
class Batch:
    """Robots in the kernel's layout; offsets count elements."""

    sizes: list[layout.Size]
    grids: list[Grid]
    counts: list[NDArray[np.int32]]
    """Masses, motors, cells and reach of every robot."""
    cell_at: NDArray[np.int32]
    mass_at: NDArray[np.int32]
    motor_at: NDArray[np.int32]
    weight_at: NDArray[np.int32]
    start: NDArray
    reference: NDArray
    mask: NDArray
    cell: NDArray[np.int32]
    motor: NDArray[np.int32]
    velocity: NDArray
    rest_length: NDArray
    stiffness_dt: NDArray
    own: NDArray
    """`layout.OWN` scalars of each robot."""
    weights: NDArray

    def controllers(self, weights: NDArray) -> list[Controller]:
        """The controllers that lie in `weights`, an array laid out as `self.weights`."""
        return [
            _controller(weights[first:], n) for first, n in zip(self.weight_at[:-1], self.sizes, strict=True)
        ]


def pack(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics],
    placed: Sequence[FloatArray],
) -> Batch:
    """`placed` are the initial positions [m], (M, 2) for each robot."""
    real = dtype(scene)
    grids = [place_on_grid(m) for m in morphologies]
    sizes = [
        layout.size(len(m.positions), m.motors, g.cell_count, g.reach)
        for m, g in zip(morphologies, grids, strict=True)
    ]
    cell_at = offsets([n.cells for n in sizes])
    mass_at = offsets([2 * n.mass_pairs for n in sizes])
    motor_at = offsets([n.padded_motors for n in sizes])
    weight_at = offsets([HIDDEN * n.weight_rows for n in sizes])
    batch = Batch(
        sizes,
        grids,
        [_int32([getattr(n, key) for n in sizes]) for key in ("masses", "motors", "cells", "reach")],
        cell_at,
        mass_at,
        motor_at,
        weight_at,
        start=aligned(2 * cell_at[-1], real),
        reference=aligned(2 * cell_at[-1], real),
        velocity=aligned(2 * cell_at[-1], real),
        mask=aligned(cell_at[-1], real),
        cell=aligned(mass_at[-1], np.int32),
        motor=aligned(motor_at[-1], np.int32),
        rest_length=aligned(FAMILIES * cell_at[-1], real),
        stiffness_dt=aligned(FAMILIES * cell_at[-1], real),
        own=aligned(layout.OWN * len(sizes), real),
        weights=aligned(weight_at[-1], real),
    )
    robots = enumerate(zip(morphologies, controllers, physics, placed, strict=True))
    for r, (body, brain, physical, at) in robots:
        n, grid, x = sizes[r], grids[r], at - ORIGIN
        cells, springs = (slice(k * cell_at[r], k * cell_at[r + 1]) for k in (2, FAMILIES))
        batch.start[cells].reshape(2, -1)[:, grid.cell] = x.T
        if scene.sensing == "centre-and-rest":
            batch.reference[cells].reshape(2, -1)[:, grid.cell] = (x - x.mean(axis=0)).T
        batch.velocity[cells].reshape(2, -1)[:, grid.cell] = physical.velocities.T
        batch.mask[cell_at[r] + grid.cell] = 1
        nowhere = n.cells - 1
        batch.cell[mass_at[r] : mass_at[r + 1]] = nowhere
        batch.cell[mass_at[r] : mass_at[r] + n.masses] = grid.cell
        spring = grid.family * n.cells + grid.first
        scheme = scene.scheme_at(physical.damping)
        batch.rest_length[springs][spring] = physical.rest_lengths
        batch.stiffness_dt[springs][spring] = physical.stiffness * scheme.force
        batch.own.reshape(-1, layout.OWN)[r] = (
            scheme.decay, physical.gravity * scheme.gravity, physical.friction,
        )  # fmt: skip
        batch.motor[motor_at[r] : motor_at[r + 1]] = nowhere
        batch.motor[motor_at[r] : motor_at[r] + n.motors] = spring[body.active]
        cpgs, sensed, b1, w2, b2 = _parts(batch.weights[weight_at[r] :], n)
        cpgs[:], sensed[:] = np.split(brain.w1.T, [CPGS])
        b1[:], w2[:], b2[:] = brain.b1, brain.w2, brain.b2
    return batch


def _controller(weights: NDArray, n: layout.Size) -> Controller:
    cpgs, sensed, b1, w2, b2 = _parts(weights, n)
    return Controller(np.concatenate([cpgs, sensed]).T, b1, w2, b2)


def _parts(weights: NDArray, n: layout.Size) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray]:
    """Views of one robot's weights without the padding: those of the pattern generators (10, 32), of x, y,
    vx, vy of each mass (4 M, 32), b1 (32,), W2 (A, 32) and b2 (A,)."""
    w1, b1, w2, b2 = np.split(
        weights[: HIDDEN * n.weight_rows], np.cumsum([n.inputs * HIDDEN, HIDDEN, n.padded_motors * HIDDEN])
    )
    rows = w1.reshape(-1, HIDDEN)
    sensed = rows[layout.CPG_ROWS :][: 4 * n.masses]
    return rows[:CPGS], sensed, b1, w2.reshape(-1, HIDDEN)[: n.motors], b2[: n.motors]


def pack_cpgs(scene: Scene) -> NDArray:
    """sin(omega t + 2 pi j / 10) for every step, padded to 16, shape (steps * 16,); t is the step's beginning
    or, where positions are half a step ahead, its middle."""
    middle = 0.5 if scene.integrator == "second-order" else 0.0
    t = (np.arange(scene.steps)[:, None] + middle) * scene.dt
    waves = np.zeros((scene.steps, layout.CPG_ROWS))
    waves[:, :CPGS] = np.sin(scene.omega * t + 2 * np.pi / CPGS * np.arange(CPGS))
    return packed(waves, dtype(scene))


def dtype(scene: Scene) -> DTypeLike:
    return np.float32 if scene.precision == "f32" else np.float64


def packed(values: NDArray, kind: DTypeLike) -> NDArray:
    """A flat, aligned copy."""
    flat = aligned(values.size, kind)
    flat[:] = values.ravel()
    return flat


def offsets(sizes: Sequence[int] | NDArray) -> NDArray[np.int32]:
    """Start of each of `n` consecutive pieces, and the end of the last, shape (n + 1,)."""
    return _int32(np.concatenate([[0], np.cumsum(sizes)]))


def _int32(values: object) -> NDArray[np.int32]:
    return np.array(values, dtype=np.int32)

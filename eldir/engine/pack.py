"""Robots, cotangents and gradients as the kernel's flat arrays, and back. The arrays are ragged and padded
only to whole vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from eldir.controller import CPGS, HIDDEN, Controller
from eldir.core.records import FloatArray, IntArray
from eldir.engine.compiler import aligned
from eldir.engine.grid import FAMILIES, Grid, place_on_grids
from eldir.engine.kernels import layout
from eldir.engine.threads import for_each
from eldir.engine.validity import max_speeds
from eldir.morphology import Bodies, Morphology, offsets
from eldir.physics import Physics
from eldir.scene import Scene

ORIGIN = np.array([0.25, 0.1])
"""Origin of the kernel's coordinates [m]: under the middle of a robot on flat ground. Float32 is finest
near 0, and what is lost of positions is what gradients lose (docs/reference/accuracy.md)."""


class MotionCotangents(NamedTuple):
    """Derivatives of a function of one robot's motion over T steps."""

    positions: FloatArray
    """With respect to the positions of all states, shape (T + 1, M, 2)."""
    velocities: FloatArray | None = None
    """With respect to the velocities of all states, shape (T + 1, M, 2); None: it does not depend on them."""
    activations: FloatArray | None = None
    """With respect to the activations, shape (T, A); None: it does not depend on them."""


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
    scalars: NDArray
    """`layout.SCALARS` numbers of each robot."""
    weights: NDArray

    def physics_offsets(self, present: bool) -> NDArray[np.int32]:
        """Offsets of each robot's gradients with respect to physics, if they are `present`."""
        return offsets([n.physics_values if present else 0 for n in self.sizes])

    def controllers(self, weights: NDArray) -> list[Controller]:
        """The controllers that lie in `weights`, an array laid out as `self.weights`."""
        return for_each(lambda r: _controller(*self.parts(weights, r)), len(self.sizes))

    def parts(self, weights: NDArray, r: int) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray]:
        """Views of one robot's weights without the padding: those of the pattern generators (10, 32), of x,
        y, vx, vy of each mass (4 M, 32), b1 (32,), W2 (A, 32) and b2 (A,)."""
        n = self.sizes[r]
        rows = weights[self.weight_at[r] : self.weight_at[r + 1]].reshape(-1, HIDDEN)
        w2 = n.inputs + 1
        b2 = rows[w2 + n.padded_motors :].ravel()
        sensed = rows[layout.CPG_ROWS : layout.CPG_ROWS + 4 * n.masses]
        return rows[:CPGS], sensed, rows[n.inputs], rows[w2 : w2 + n.motors], b2[: n.motors]


def _controller(cpgs: NDArray, sensed: NDArray, b1: NDArray, w2: NDArray, b2: NDArray) -> Controller:
    w1 = np.empty((CPGS + len(sensed), HIDDEN))
    w1[:CPGS], w1[CPGS:] = cpgs, sensed
    return Controller.construct(w1.T, *(w.astype(np.float64) for w in (b1, w2, b2)))


def pack(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics],
) -> Batch:
    """The robots, placed on the ground."""
    bodies = Bodies(morphologies)
    grids = place_on_grids(bodies)
    motors = np.bincount(bodies.of_spring[bodies["active"]], minlength=len(bodies))
    sizes = layout.size(np.diff(bodies.mass_at), motors, *(np.array([g[k] for g in grids]) for k in (1, 0)))
    batch = _empty_batch(sizes, grids, dtype(scene))
    _pack_masses(batch, sizes, bodies, scene, physics)
    _pack_springs(batch, sizes, bodies, scene, physics)

    def pack_weights(r: int) -> None:
        brain, (cpgs, sensed, b1, w2, b2) = controllers[r], batch.parts(batch.weights, r)
        cpgs[:], sensed[:] = brain.w1[:, :CPGS].T, brain.w1[:, CPGS:].T
        b1[:], w2[:], b2[:] = brain.b1, brain.w2, brain.b2

    for_each(pack_weights, len(bodies))
    return batch


def _empty_batch(sizes: layout.Size, grids: list[Grid], real: DTypeLike) -> Batch:
    """Arrays of zeros; `sizes` holds an array for all robots in each field."""
    cell_at, mass_at, motor_at, weight_at = (
        offsets(n)
        for n in (sizes.cells, 2 * sizes.mass_pairs, sizes.padded_motors, HIDDEN * sizes.weight_rows)
    )
    return Batch(
        [layout.Size(*n) for n in zip(*(n.tolist() for n in sizes), strict=True)],
        grids,
        [_int32(n) for n in (sizes.masses, sizes.motors, sizes.cells, sizes.reach)],
        cell_at, mass_at, motor_at, weight_at,
        start=aligned(2 * cell_at[-1], real),
        reference=aligned(2 * cell_at[-1], real),
        velocity=aligned(2 * cell_at[-1], real),
        mask=aligned(cell_at[-1], real),
        cell=aligned(mass_at[-1], np.int32),
        motor=aligned(motor_at[-1], np.int32),
        rest_length=aligned(FAMILIES * cell_at[-1], real),
        stiffness_dt=aligned(FAMILIES * cell_at[-1], real),
        scalars=aligned(layout.SCALARS * len(grids), real),
        weights=aligned(weight_at[-1], real),
    )  # fmt: skip


def _pack_masses(
    batch: Batch, sizes: layout.Size, bodies: Bodies, scene: Scene, physics: Sequence[Physics]
) -> None:
    cell = np.concatenate([g.cell for g in batch.grids])
    plane = 2 * batch.cell_at[bodies.of_mass] + cell
    planes = np.stack([plane, plane + sizes.cells[bodies.of_mass]], axis=1)  # of x and of y
    x = place(bodies, scene) - ORIGIN
    batch.start[planes] = x
    if scene.sensing == "centre-and-rest":
        centre = np.stack([np.bincount(bodies.of_mass, c) for c in x.T], axis=1) / sizes.masses[:, None]
        batch.reference[planes] = x - centre[bodies.of_mass]
    batch.velocity[planes] = np.concatenate([own.velocities for own in physics])
    batch.mask[batch.cell_at[bodies.of_mass] + cell] = 1
    batch.cell[:] = np.repeat(sizes.cells - 1, np.diff(batch.mass_at))  # the empty cell
    batch.cell[_shifted_indices(bodies.of_mass, bodies.mass_at, batch.mass_at)] = cell


def _pack_springs(
    batch: Batch, sizes: layout.Size, bodies: Bodies, scene: Scene, physics: Sequence[Physics]
) -> None:
    family, first = (np.concatenate([getattr(g, k) for g in batch.grids]) for k in ("family", "first"))
    spring, active = family * sizes.cells[bodies.of_spring] + first, bodies["active"]
    batch.motor[:] = np.repeat(sizes.cells - 1, np.diff(batch.motor_at))
    motors = _shifted_indices(bodies.of_spring[active], offsets(sizes.motors), batch.motor_at)
    batch.motor[motors] = spring[active]
    spring += FAMILIES * batch.cell_at[bodies.of_spring]
    schemes = {own.damping: scene.scheme_at(own.damping) for own in physics}
    force = np.array([schemes[own.damping].force for own in physics])
    batch.rest_length[spring] = np.concatenate([own.rest_lengths for own in physics])
    batch.stiffness_dt[spring] = np.concatenate([own.stiffness for own in physics]) * force[bodies.of_spring]
    scalars = ((schemes[o.damping], o) for o in physics)
    fastest = max_speeds(bodies, scene, physics)
    batch.scalars[:] = [
        v
        for (s, o), speed in zip(scalars, fastest, strict=True)
        for v in (s.decay, o.gravity * s.gravity, o.friction, speed**2)
    ]


def place(bodies: Bodies, scene: Scene) -> FloatArray:
    """Initial positions of all masses [m], shape (M, 2): as developed, and each body lifted until no mass is
    below the ground."""
    x = bodies["positions"]
    above = x[:, 1] - scene.terrain.height(x[:, 0])
    x[:, 1] += np.maximum(-bodies.least(above), 0.0)
    return x


def _shifted_indices(owner: IntArray, before: IntArray, at: IntArray) -> IntArray:
    """Indices of masses or motors where those of each robot, which began at `before`, begin at `at`."""
    return np.arange(len(owner)) + (at[:-1] - before[:-1])[owner]


def pack_cpgs(scene: Scene) -> NDArray:
    """sin(omega t + 2 pi j / 10) for every step, padded to 16, shape (steps * 16,); t is the step's beginning
    or, where positions are half a step ahead, its middle."""
    middle = 0.5 if scene.integrator == "second-order" else 0.0
    t = (np.arange(scene.steps)[:, None] + middle) * scene.dt
    waves = np.zeros((scene.steps, layout.CPG_ROWS))
    waves[:, :CPGS] = np.sin(scene.omega * t + 2 * np.pi / CPGS * np.arange(CPGS))
    return packed(waves, dtype(scene))


def pack_cotangents(
    cotangents: Sequence[MotionCotangents] | None,
    sizes: Sequence[layout.Size],
    grids: Sequence[Grid],
    scene: Scene,
) -> tuple[NDArray, NDArray[np.int32], int]:
    """Cotangents in the kernel's layout, where each robot's begin, and `RunSettings.cotangents_given`.

    Where the kernel's positions are half a step ahead, a state's position is the mean of two of them.
    """
    if cotangents is None:
        return aligned(layout.LANES, dtype(scene)), offsets([0] * len(sizes)), 0
    complete = any(c.velocities is not None or c.activations is not None for c in cotangents)
    lanes = [n.recorded_rows if complete else 2 * n.cell_rows for n in sizes]
    at = offsets([layout.LANES * n * (scene.steps + 1) for n in lanes])
    flat = aligned(int(at[-1]), dtype(scene))
    for r, (given, n, grid) in enumerate(zip(cotangents, sizes, grids, strict=True)):
        states = flat[at[r] : at[r + 1]].reshape(scene.steps + 1, -1)
        positions = given.positions
        if scene.integrator == "second-order":
            positions = 0.5 * positions
            positions[0] = 0  # where a robot begins depends on nothing
            positions[:-1] += positions[1:]
        for c in range(2):
            states[:, c * n.cells + grid.cell] = positions[:, :, c]
            if given.velocities is not None:
                states[:, (2 + c) * n.cells + grid.cell] = given.velocities[:, :, c]
        if given.activations is not None:
            states[:-1, 4 * n.cells : 4 * n.cells + n.motors] = given.activations
    return flat, at, 2 if complete else 1


def physics_gradients(
    values: NDArray, batch: Batch, scene: Scene, physics: Sequence[Physics]
) -> list[Physics]:
    """Gradients with respect to each robot's parameters, from those with respect to decay, gravity and
    stiffness of one step (`layout.PhysicsGradients`)."""
    gradients = []
    at = batch.physics_offsets(True)
    for first, n, grid, own in zip(at[:-1], batch.sizes, batch.grids, physics, strict=True):
        own_values = values[first : first + n.physics_values].astype(np.float64)
        counts = np.cumsum([FAMILIES * n.cells, FAMILIES * n.cells, 2 * n.cells])
        stiffness, rest, velocity, scalars = np.split(own_values, counts)
        decay, gravity, friction = (float(s) for s in scalars.reshape(3, -1).sum(axis=1))
        spring = grid.family * n.cells + grid.first
        by_stiffness = stiffness[spring]
        scheme, d_scheme = scene.scheme_at(own.damping), scene.scheme_derivative(own.damping)
        gradients.append(
            Physics(
                stiffness=scheme.force * by_stiffness,
                rest_lengths=rest[spring],
                velocities=velocity.reshape(2, -1)[:, grid.cell].T,
                damping=d_scheme.decay * decay
                + d_scheme.gravity * own.gravity * gravity
                + d_scheme.force * float(own.stiffness @ by_stiffness),
                gravity=scheme.gravity * gravity,
                friction=friction,
            )
        )
    return gradients


def dtype(scene: Scene) -> DTypeLike:
    return np.float32 if scene.precision == "f32" else np.float64


def packed(values: NDArray, kind: DTypeLike) -> NDArray:
    """A flat, aligned copy."""
    flat = aligned(values.size, kind)
    flat[:] = values.ravel()
    return flat


def _int32(values: object) -> NDArray[np.int32]:
    return np.array(values, dtype=np.int32)

"""From records to the kernel's flat arrays and back: ragged, padded only to whole vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike, NDArray

from eldir.controller import CPGS, HIDDEN, Controller
from eldir.engine import layout
from eldir.engine.runtime import aligned
from eldir.morphology import Morphology
from eldir.scene import Scene


@dataclass
class Batch:
    """Robots as the kernel sees them; offsets count elements."""

    sizes: list[layout.Size]
    masses: NDArray[np.int32]
    springs: NDArray[np.int32]
    motors: NDArray[np.int32]
    mass_at: NDArray[np.int32]
    spring_at: NDArray[np.int32]
    weight_at: NDArray[np.int32]
    start: NDArray
    reference: NDArray
    mask: NDArray
    a: NDArray[np.int32]
    b: NDArray[np.int32]
    rest_length: NDArray
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
    placed: Sequence[NDArray[np.float64]],
) -> Batch:
    """`placed` are the initial positions [m], (M, 2) for each robot."""
    real = dtype(scene)
    sizes = [layout.size(len(m.positions), len(m.springs), m.motors) for m in morphologies]
    mass_at = offsets([n.padded_masses for n in sizes])
    spring_at = offsets([n.padded_springs for n in sizes])
    weight_at = offsets([HIDDEN * n.weight_rows for n in sizes])
    batch = Batch(
        sizes,
        *(_int32([n[i] for n in sizes]) for i in range(3)),
        mass_at,
        spring_at,
        weight_at,
        start=aligned(2 * mass_at[-1], real),
        reference=aligned(2 * mass_at[-1], real),
        mask=aligned(mass_at[-1], real),
        a=aligned(spring_at[-1], np.int32),
        b=aligned(spring_at[-1], np.int32),
        rest_length=aligned(spring_at[-1], real),
        weights=aligned(weight_at[-1], real),
    )
    for r, (body, brain, x) in enumerate(zip(morphologies, controllers, placed, strict=True)):
        n, first = sizes[r], mass_at[r]
        both = slice(2 * first, 2 * mass_at[r + 1])
        batch.start[both].reshape(2, -1)[:, : n.masses] = x.T
        if scene.sensing == "centre-and-rest":
            batch.reference[both].reshape(2, -1)[:, : n.masses] = (x - x.mean(axis=0)).T
        batch.mask[first : first + n.masses] = 1
        motors_first = np.argsort(~body.active, kind="stable")
        span = slice(spring_at[r], spring_at[r] + n.springs)
        batch.a[span], batch.b[span] = body.springs[motors_first].T
        batch.rest_length[span] = body.rest_lengths[motors_first]
        sensed, cpgs, b1, w2, b2 = _parts(batch.weights[weight_at[r] :], n)
        sensed[:] = brain.w1[:, CPGS:].reshape(HIDDEN, n.masses, 4).transpose(2, 1, 0)
        cpgs[:], b1[:], w2[:], b2[:] = brain.w1[:, :CPGS].T, brain.b1, brain.w2, brain.b2
    return batch


def _controller(weights: NDArray, n: layout.Size) -> Controller:
    sensed, cpgs, b1, w2, b2 = _parts(weights, n)
    interleaved = sensed.transpose(2, 1, 0).reshape(HIDDEN, 4 * n.masses)
    return Controller(np.concatenate([cpgs.T, interleaved], axis=1), b1, w2, b2)


def _parts(weights: NDArray, n: layout.Size) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray]:
    """Views of one robot's weights without the padding: those of x, y, vx, vy (4, M, 32), of the pattern
    generators (10, 32), b1 (32,), W2 (A, 32) and b2 (A,)."""
    w1, b1, w2, b2 = np.split(
        weights[: HIDDEN * n.weight_rows], np.cumsum([n.inputs * HIDDEN, HIDDEN, n.padded_motors * HIDDEN])
    )
    rows = w1.reshape(-1, HIDDEN)
    sensed = rows[: 4 * n.padded_masses].reshape(4, -1, HIDDEN)[:, : n.masses]
    cpgs = rows[4 * n.padded_masses :][:CPGS]
    return sensed, cpgs, b1, w2.reshape(-1, HIDDEN)[: n.motors], b2[: n.motors]


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


def padded_array(counts: NDArray[np.int32], multiple: int) -> NDArray[np.int64]:
    """Counts rounded up."""
    return -(-counts.astype(np.int64) // multiple) * multiple


def offsets(sizes: Sequence[int] | NDArray) -> NDArray[np.int32]:
    """Where each of some consecutive pieces begins, and the end, shape (n + 1,)."""
    return _int32(np.concatenate([[0], np.cumsum(sizes)]))


def _int32(values: object) -> NDArray[np.int32]:
    return np.array(values, dtype=np.int32)

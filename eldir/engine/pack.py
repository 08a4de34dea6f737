"""From records to the kernel's flat arrays and back: ragged, padded only to whole vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eldir.controller import CPGS, HIDDEN, Controller
from eldir.engine.runtime import aligned, padded
from eldir.morphology import Morphology
from eldir.scene import Scene

_CPG_ROWS = 16
_CHUNK = 50


@dataclass
class Batch:
    """Robots as the kernel sees them; offsets count elements."""

    masses: NDArray[np.int32]
    springs: NDArray[np.int32]
    motors: NDArray[np.int32]
    mass_at: NDArray[np.int32]
    spring_at: NDArray[np.int32]
    weight_at: NDArray[np.int32]
    start: NDArray
    reference: NDArray
    mask: NDArray
    spring_a: NDArray[np.int32]
    spring_b: NDArray[np.int32]
    rest: NDArray
    weights: NDArray
    order: list[NDArray[np.intp]]
    """Springs of each robot as the kernel takes them: active ones first."""

    def workspace(self, steps: int) -> int:
        """Elements that one worker needs for the largest robot."""
        mp = int(padded_array(self.masses, 16).max())
        sp = int(padded_array(self.springs, 16).max())
        ap = int(padded_array(self.motors, 32).max())
        history = (6 * mp + 32 + ap + 2 * sp) * (steps + 1)
        scratch = 4 * mp + 32 + 128 * mp + 32 * ap + _CHUNK * (32 + ap + 4 * mp + 32)
        adjoint = 2 * sp + 12 * mp + 64
        weights = (4 * mp + _CPG_ROWS + 1 + ap) * HIDDEN + ap
        return padded(history + scratch + adjoint + weights + 64, 32)

    def controllers(self, weights: NDArray) -> list[Controller]:
        """The controllers that lie in `weights`, an array laid out as `self.weights`."""
        return [self._controller(weights, r) for r in range(len(self.masses))]

    def _controller(self, weights: NDArray, r: int) -> Controller:
        m, a = int(self.masses[r]), int(self.motors[r])
        w1, b1, w2, b2 = _views(weights[self.weight_at[r] : self.weight_at[r + 1]], m, a)
        sensed = w1[: 4 * padded(m, 16)].reshape(4, -1, HIDDEN)[:, :m]  # channel, mass, hidden
        interleaved = sensed.transpose(2, 1, 0).reshape(HIDDEN, 4 * m)
        cpgs = w1[4 * padded(m, 16) :][:CPGS].T
        return Controller(np.concatenate([cpgs, interleaved], axis=1), b1, w2[:a], b2[:a])


def pack(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    placed: Sequence[NDArray[np.float64]],
) -> Batch:
    """`placed` are the initial positions [m], (M, 2) for each robot."""
    dtype = np.float32 if scene.precision == "f32" else np.float64
    masses = np.array([len(m.positions) for m in morphologies], np.int32)
    springs = np.array([len(m.springs) for m in morphologies], np.int32)
    motors = np.array([m.motors for m in morphologies], np.int32)
    mp, sp, ap = padded_array(masses, 16), padded_array(springs, 16), padded_array(motors, 32)
    mass_at, spring_at = offsets(mp), offsets(sp)
    weight_at = offsets((4 * mp + _CPG_ROWS + 1 + ap) * HIDDEN + ap)
    batch = Batch(
        masses, springs, motors, mass_at, spring_at, weight_at,
        start=aligned(2 * int(mp.sum()), dtype), reference=aligned(2 * int(mp.sum()), dtype),
        mask=aligned(int(mp.sum()), dtype), spring_a=aligned(int(sp.sum()), np.int32),
        spring_b=aligned(int(sp.sum()), np.int32), rest=aligned(int(sp.sum()), dtype),
        weights=aligned(int(weight_at[-1]), dtype), order=[],
    )  # fmt: skip
    for r, (body, brain, x) in enumerate(zip(morphologies, controllers, placed, strict=True)):
        m, a = masses[r], motors[r]
        start = batch.start[2 * mass_at[r] : 2 * mass_at[r + 1]].reshape(2, -1)
        start[:, :m] = x.T
        if scene.sensing == "centre-and-rest":
            reference = batch.reference[2 * mass_at[r] : 2 * mass_at[r + 1]].reshape(2, -1)
            reference[:, :m] = (x - x.mean(axis=0)).T
        batch.mask[mass_at[r] : mass_at[r] + m] = 1
        order = np.argsort(~body.active, kind="stable")
        batch.order.append(order)
        span = slice(spring_at[r], spring_at[r] + springs[r])
        batch.spring_a[span], batch.spring_b[span] = body.springs[order].T
        batch.rest[span] = body.rest_lengths[order]
        w1, b1, w2, b2 = _views(batch.weights[weight_at[r] : weight_at[r + 1]], m, a)
        sensed = w1[: 4 * mp[r]].reshape(4, -1, HIDDEN)
        sensed[:, :m] = brain.w1[:, CPGS:].reshape(HIDDEN, m, 4).transpose(2, 1, 0)
        w1[4 * mp[r] : 4 * mp[r] + CPGS] = brain.w1[:, :CPGS].T
        b1[:], w2[:a], b2[:a] = brain.b1, brain.w2, brain.b2
    return batch


def pack_ground(scene: Scene) -> NDArray:
    """Rows x0, slope, intercept, level; the last two differ only in the released code's scene.

    That code reads out of bounds left of x = 0: there it behaves as a line y = 0 to be hit and a
    floor at 0.1 m (docs/decisions/0001).
    """
    t = scene.terrain
    x0, rows = t.x0.copy(), np.stack([t.x0, t.slope, t.intercept, t.intercept], axis=1)
    if scene.contact == "friction-released":
        ahead = np.append(x0[1:], np.inf) > 0
        rows = np.concatenate([[[-np.inf, 0, 0, 0.1]], rows[ahead]])
        rows[1, 0] = 0.0
    flat = aligned(rows.size, np.float32 if scene.precision == "f32" else np.float64)
    flat[:] = rows.ravel()
    return flat


def pack_cpgs(scene: Scene) -> NDArray:
    """sin(omega t dt + 2 pi j / 10) for every step, padded to 16, shape (steps * 16,)."""
    t = np.arange(scene.steps)[:, None] * scene.dt
    waves = np.zeros((scene.steps, _CPG_ROWS))
    waves[:, :CPGS] = np.sin(scene.omega * t + 2 * np.pi / CPGS * np.arange(CPGS))
    flat = aligned(waves.size, np.float32 if scene.precision == "f32" else np.float64)
    flat[:] = waves.ravel()
    return flat


def _views(weights: NDArray, m: int, a: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """W1 (inputs, 32), b1 (32,), W2 (A padded, 32) and b2 inside one robot's weights."""
    inputs, ap = 4 * padded(int(m), 16) + _CPG_ROWS, padded(int(a), 32)
    w1, b1, w2, b2 = np.split(weights, np.cumsum([inputs * HIDDEN, HIDDEN, ap * HIDDEN]))
    return w1.reshape(inputs, HIDDEN), b1, w2.reshape(ap, HIDDEN), b2


def padded_array(counts: NDArray[np.int32], multiple: int) -> NDArray[np.int64]:
    """Counts rounded up."""
    return -(-counts.astype(np.int64) // multiple) * multiple


def offsets(sizes: NDArray) -> NDArray[np.int32]:
    """Where each of some consecutive pieces begins, and the end, shape (n + 1,)."""
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)

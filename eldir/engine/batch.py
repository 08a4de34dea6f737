"""Running a batch: pack, call the kernel, unpack. The one door to the engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eldir.controller import Controller
from eldir.engine.kernel import build
from eldir.engine.pack import Batch, offsets, pack, pack_cpgs, pack_ground, padded_array
from eldir.engine.runtime import aligned, threads
from eldir.morphology import Morphology
from eldir.scene import Scene

# Constants of the scheme (released code): a mass slower than this does not hit flat ground [m/s];
# what is added to a length [m], to a normal speed [m/s] and to the gradient's norm before dividing.
_RESTING, _SOFTENING, _TINY, _LEAST_GRADIENT = 1e-4, 1e-4, 1e-10, 1e-6
_SENSE = 0.05
_RELEASED_BIAS_GAIN = 3.0  # two constant inputs beside the bias move it by three gradients


@dataclass
class Outcome:
    """What the kernel wrote, in the order of the robots."""

    batch: Batch
    losses: NDArray[np.float64]
    """Shape (n, iterations + 1); infinite from where a robot blew up."""
    status: NDArray[np.int32]
    """-1, or the step at which the robot blew up."""
    best: NDArray
    """Best weights or, without iterations, gradients; laid out as the batch's weights."""
    record: NDArray
    record_at: NDArray[np.int64]

    def states(self, r: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Positions and velocities (T + 1, M, 2) and activations (T, A) of robot `r`."""
        m, a = int(self.batch.masses[r]), int(self.batch.motors[r])
        mp, ap = (int(padded_array(np.array([n]), k)[0]) for n, k in ((m, 16), (a, 32)))
        rows = self.record[16 * self.record_at[r] : 16 * self.record_at[r + 1]].astype(np.float64)
        rows = rows.reshape(-1, 4 * mp + ap)
        x, y, vx, vy = (rows[:, c * mp : c * mp + m] for c in range(4))
        return np.stack([x, y], axis=2), np.stack([vx, vy], axis=2), rows[:-1, 4 * mp : 4 * mp + a]


def run(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    *,
    iterations: int = 0,
    backward: bool = False,
    record: bool = False,
) -> Outcome:
    """Simulate all robots; with `backward`, differentiate and, with `iterations`, teach them."""
    dtype = np.float32 if scene.precision == "f32" else np.float64
    placed = [place(m, scene) for m in morphologies]
    batch = pack(morphologies, controllers, scene, placed)
    n = len(morphologies)
    workers = min(threads(), n)
    size = batch.workspace(scene.steps)
    workspace = aligned(size * workers, dtype)
    losses = aligned(n * (iterations + 1), dtype)
    losses[:] = np.inf
    status = aligned(n, np.int32)
    best = aligned(len(batch.weights) if backward else 32, dtype)
    widths = (4 * padded_array(batch.masses, 16) + padded_array(batch.motors, 32)) // 16
    record_at = offsets(widths * (scene.steps + 1) if record else np.zeros(n))
    states = aligned(16 * max(int(record_at[-1]), 1), dtype)
    ground = pack_ground(scene)
    terrain = scene.terrain
    # No ground is higher than this, and only rugged ground extends for ever.
    bends = terrain.height(terrain.x0).max() if (terrain.slope[[0, -1]] == 0).all() else np.inf
    top = max(float(bends), float(terrain.intercept[0]), 0.1)
    build(scene.precision).run(
        n, workers, scene.steps, iterations, size,
        scene.dt, float(np.exp(-scene.damping * scene.dt)), scene.gravity * scene.dt,
        scene.stiffness * scene.dt, scene.actuation, _SENSE, _SOFTENING,
        float(terrain.intercept[0]), _RESTING, _TINY, _LEAST_GRADIENT, scene.update_length,
        _RELEASED_BIAS_GAIN if scene.weights == "released" else 1.0,
        backward, scene.contact != "no-slip", record,
        len(ground) // 4, top, ground, pack_cpgs(scene).reshape(-1, 16),
        aligned(1, np.int32), batch.masses, batch.springs, batch.motors, batch.mass_at, batch.spring_at,
        batch.weight_at, record_at, batch.start.reshape(-1, 16), batch.reference.reshape(-1, 16),
        batch.mask.reshape(-1, 16), batch.spring_a, batch.spring_b, batch.rest.reshape(-1, 16),
        batch.weights, batch.weights.reshape(-1, 32), batch.weights.reshape(-1, 16),
        best.reshape(-1, 32), workspace, workspace.reshape(-1, 32), workspace.reshape(-1, 16),
        workspace.reshape(-1, 2), losses, status, states.reshape(-1, 16),
    )  # fmt: skip
    values = losses.astype(np.float64).reshape(n, iterations + 1)
    return Outcome(batch, values, status, best, states, record_at)


def place(morphology: Morphology, scene: Scene) -> NDArray[np.float64]:
    """Initial positions [m]: as developed, lifted until no mass is below the ground."""
    x = morphology.positions
    below = scene.terrain.height(x[:, 0]) - x[:, 1]
    return x + np.array([0.0, max(float(below.max()), 0.0)])

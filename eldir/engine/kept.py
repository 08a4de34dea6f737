"""Rollouts whose states stay in memory until they are differentiated, so that a function of them needs no
second simulation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from eldir.controller import HIDDEN, Controller
from eldir.core.records import IntArray
from eldir.engine import batch
from eldir.engine.kernels import layout
from eldir.engine.pack import ORIGIN, MotionCotangents, pack, pack_cotangents
from eldir.engine.runtime import start
from eldir.engine.threads import worker_threads
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene

_CONFIG = batch.BatchConfig(backward=True, physics_gradients=True, keep=True)
_ROBOTS_A_THREAD = 8  # more at a time would leave the processor's cache, fewer would let threads wait
_MAX_VALUES = 2**28  # kept at a time: 1 GB in float32


class KeptRollouts:
    """The simulated robots. Their states are in the precision of the scene, without copies."""

    def __init__(
        self,
        morphologies: Sequence[Morphology],
        controllers: Sequence[Controller],
        scene: Scene,
        physics: Sequence[Physics],
    ):
        start()
        self._scene, self._physics = scene, list(physics)
        self._batch = pack(morphologies, controllers, scene, self._physics)
        self._nowhere = np.zeros(len(morphologies) + 1, np.int32)
        launch = batch.make_launch(self._batch, scene, _CONFIG, None, self._nowhere)
        self._launch = launch._replace(settings=launch.settings._replace(backward=False))
        self.status: IntArray = self._run().status.copy()
        """-1, or the step at which the robot diverged; later states are then undefined."""

    def _run(self) -> batch.BatchResult:
        return batch.run_launch(self._launch, self._batch, self._scene, _CONFIG, self._physics, self._nowhere)

    def positions(self, r: int) -> NDArray:
        """Positions of robot `r` [m], shape (T + 1, M, 2)."""
        positions = self._planes(r, 0)
        positions += ORIGIN
        if self._scene.integrator == "second-order":
            positions[1:] = 0.5 * (positions[1:] + positions[:-1])
            cells = slice(2 * self._batch.cell_at[r], 2 * self._batch.cell_at[r + 1])
            positions[0] = self._batch.start[cells].reshape(2, -1)[:, self._batch.grids[r].cell].T + ORIGIN
        return positions

    def velocities(self, r: int) -> NDArray:
        """Velocities of robot `r` [m/s], shape (T + 1, M, 2)."""
        return self._planes(r, 2)

    def activations(self, r: int) -> NDArray:
        """Activations of robot `r`, shape (T, A)."""
        n = self._batch.sizes[r]
        first = 6 * n.cells + n.padded_rows + HIDDEN
        return self._states(r)[:-1, first : first + n.motors]

    def _states(self, r: int) -> NDArray:
        """The history of robot `r` (`layout.StateHistory`), one row for each state."""
        width, first = self._batch.sizes[r].state_values, r * self._launch.workspace
        values = self._launch.work.values[first : first + width * (self._scene.steps + 1)]
        return values.reshape(-1, width)

    def _planes(self, r: int, first: int) -> NDArray:
        n, cell = self._batch.sizes[r], self._batch.grids[r].cell
        columns = np.stack([first * n.cells + cell, (first + 1) * n.cells + cell], axis=1)
        return np.take(self._states(r), columns, axis=1)

    def differentiate(self, cotangents: Sequence[MotionCotangents]) -> batch.BatchResult:
        """The gradients of the sum of each robot's motion times its cotangents."""
        flat, at, given = pack_cotangents(cotangents, self._batch, self._scene)
        table = self._launch.offsets.reshape(len(self.status), -1)
        table[:, layout.RobotOffsets._fields.index("cotangents_at")] = at[:-1]
        settings = self._launch.settings._replace(resumed=True, backward=True, cotangents_given=given)
        self._launch = self._launch._replace(settings=settings, cotangents=flat.reshape(-1, 16))
        return self._run()


def split_to_keep(morphologies: Sequence[Morphology], scene: Scene) -> Iterator[slice]:
    """Consecutive robots whose states are kept at the same time."""
    most = _ROBOTS_A_THREAD * worker_threads()
    first, largest = 0, 0
    for i, body in enumerate(morphologies):
        size = (16 * len(body.positions) + 2 * body.motors + 256) * (scene.steps + 1)  # more than it takes
        largest = max(largest, size)
        if i > first and (i - first == most or (i - first + 1) * largest > _MAX_VALUES):
            yield slice(first, i)
            first, largest = i, size
    if first < len(morphologies):
        yield slice(first, len(morphologies))

"""Rollouts whose states stay in memory until they are differentiated, so that a function of them needs no
second simulation.

Few robots at a time: their states lie in the processor's cache.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from eldir.controller import HIDDEN, Controller
from eldir.engine import batch
from eldir.engine.kernels import layout
from eldir.engine.pack import ORIGIN, MotionCotangents, dtype, pack, pack_cotangents
from eldir.engine.runtime import start
from eldir.engine.threads import worker_threads
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene

_ROBOTS_A_THREAD = (4, 8)
"""Fewest and most robots at a time for each thread: few launches, and few bytes (docs/decisions/0069)."""
_CACHED = 2**24  # of a thread's robots [bytes]
_MAX_VALUES = 2**28  # kept at a time: 1 GB in float32


class KeptRollouts:
    """Robots that are simulated and then differentiated, part by part. Their states are in the precision of
    the scene."""

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
        largest = (scene.steps + 1) * max(n.state_values for n in self._batch.sizes)
        fitting = int(np.clip(_CACHED // (largest * np.dtype(dtype(scene)).itemsize), *_ROBOTS_A_THREAD))
        self._at_once = min(fitting * worker_threads(), max(1, _MAX_VALUES // largest), len(morphologies))
        config = batch.BatchConfig(backward=True, physics_gradients=True, keep=self._at_once)
        self._nowhere = np.zeros(len(physics) + 1, np.int32)
        self._launch = batch.make_launch(self._batch, scene, config, None, self._nowhere)
        batch.clear_results(self._launch)
        self.status = self._launch.status
        """Of each robot that has been simulated: -1, or the step at which it diverged; later states are then
        undefined."""

    def parts(self) -> Iterator[range]:
        """Simulates some robots after the other; the states of a part are there until the next."""
        for first in range(0, len(self._physics), self._at_once):
            robots = range(first, min(first + self._at_once, len(self._physics)))
            self._run(robots, backward=False, resumed=False)
            yield robots

    def differentiate(self, robots: range, cotangents: Sequence[MotionCotangents]) -> None:
        """The gradients of the sum of each robot's motion times its cotangents, for the present part."""
        here = slice(robots.start, robots.stop)
        sizes, grids = self._batch.sizes[here], self._batch.grids[here]
        flat, at, given = pack_cotangents(cotangents, sizes, grids, self._scene)
        table = self._launch.offsets.reshape(len(self._physics), -1)
        column = layout.RobotOffsets._fields.index("cotangents_at")
        table[here, column] = at[:-1]
        self._launch = self._launch._replace(cotangents=flat.reshape(-1, 16))
        self._run(robots, backward=True, resumed=True, cotangents_given=given)

    def result(self) -> batch.BatchResult:
        """The gradients of all robots."""
        return batch.read_results(self._launch, self._batch, self._scene, self._physics, self._nowhere)

    def _run(self, robots: range, **settings: int) -> None:
        changed = self._launch.settings._replace(kept_from=robots.start, **settings)
        self._launch = self._launch._replace(settings=changed, robots=robots.stop)
        batch.run_kernel(self._launch, self._scene)

    def positions(self, r: int) -> NDArray:
        """Positions of robot `r` [m], shape (T + 1, M, 2)."""
        positions = self._planes(r, 0, ORIGIN)
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
        return self._states(r)[:-1, first : first + n.motors].copy()

    def _states(self, r: int) -> NDArray:
        """The history of robot `r` (`layout.StateHistory`), one row for each state."""
        width, launch = self._batch.sizes[r].state_values, self._launch
        first = (r - launch.settings.kept_from) * launch.workspace
        return launch.work.values[first : first + width * (self._scene.steps + 1)].reshape(-1, width)

    def _planes(self, r: int, first: int, origin: NDArray | None = None) -> NDArray:
        """Two quantities of all masses, such as x and y, from an origin."""
        n, cell = self._batch.sizes[r], self._batch.grids[r].cell
        columns = np.stack([first * n.cells + cell, (first + 1) * n.cells + cell], axis=1)
        values = np.take(self._states(r), columns.ravel(), axis=1)
        if origin is not None:
            values += np.tile(origin, len(cell)).astype(values.dtype)  # as one row: NumPy is slow with pairs
        return values.reshape(-1, len(cell), 2)

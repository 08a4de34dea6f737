"""Simulating a batch of closed-loop robots: pack, launch the kernel, unpack. All other rooms use this
module."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eldir.controller import Controller
from eldir.core.records import FloatArray
from eldir.engine.aligned import aligned
from eldir.engine.device import records as device
from eldir.engine.device.process import compute as compute_on_device
from eldir.engine.device.process import learns_on_device
from eldir.engine.ground import pack_ground
from eldir.engine.kernels import contact, layout
from eldir.engine.kernels.learning_kernel import learning_kernel
from eldir.engine.kernels.learning_launch import (
    GroundArrays,
    LearningLaunch,
    RobotArrays,
    RunSettings,
    SceneNumbers,
    UpdateRule,
    ValuesAndLanes,
    WeightViews,
    WorkspaceViews,
)
from eldir.engine.pack import ORIGIN, Batch, dtype, pack, pack_cpgs, packed
from eldir.engine.physical import pack_cotangents, physics_gradients
from eldir.engine.runtime import prefer, start
from eldir.engine.shortcuts import ALL, RING, Shortcuts
from eldir.engine.threads import worker_threads
from eldir.errors import InputError
from eldir.morphology import Morphology, offsets
from eldir.physics import Physics, physics_of
from eldir.scene import SOFTENING, Scene

# Constants of the scheme (docs/decisions/0001): the least speed of a landing [m/s] over the step, 1e-4 at the
# released code's 4 ms (a constant would let resting masses slide where gravity gives less in a step); what
# keeps speeds from dividing by zero [m/s], and the same for the gradient's norm.
_RESTING, _TINY, _LEAST_GRADIENT = 0.025, 1e-10, 1e-6
_SENSE = 0.05
_RELEASED_BIAS_GAIN = 3.0  # two constant inputs beside the bias move it by three gradients
_INDEX_LIMIT = 2**31  # the kernel counts in 32 bits


@dataclass
class BatchResult:
    """The kernel's results, in the order of the robots."""

    batch: Batch
    losses: NDArray[np.float64]
    """Losses [m], shape (n, iterations + 1); infinite from the update at which a robot blew up."""
    status: NDArray[np.int32]
    """-1, or the step at which the robot blew up."""
    best: NDArray
    """Best weights or, without iterations, gradients; in the layout of the batch's weights."""
    record: NDArray
    record_at: NDArray[np.int32]
    staggered: bool
    """Whether positions are recorded half a step after velocities."""
    physics: list[Physics]
    """Gradients with respect to each robot's physics; empty unless they were requested."""

    def states(self, r: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions and velocities (T + 1, M, 2) and activations (T, A) of robot `r`."""
        n = self.batch.sizes[r]
        rows = self.record[16 * self.record_at[r] : 16 * self.record_at[r + 1]].astype(np.float64)
        rows = rows.reshape(-1, 16 * n.recorded_rows)
        x, y, vx, vy = (rows[:, c * n.cells + self.batch.grids[r].cell] for c in range(4))
        actions = rows[:-1, 4 * n.cells :][:, : n.motors]
        positions = np.stack([x, y], axis=2) + ORIGIN
        if self.staggered:
            positions[1:] = 0.5 * (positions[1:] + positions[:-1])
            positions[0] = self.start(r)
        return positions, np.stack([vx, vy], axis=2), actions

    def start(self, r: int) -> FloatArray:
        """Initial positions of the masses of robot `r` [m], shape (M, 2)."""
        cells = slice(2 * self.batch.cell_at[r], 2 * self.batch.cell_at[r + 1])
        return self.batch.start[cells].reshape(2, -1)[:, self.batch.grids[r].cell].T + ORIGIN


def run_batch(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None = None,
    *,
    iterations: int = 0,
    backward: bool = False,
    physical: bool = False,
    cotangents: Sequence[FloatArray] | None = None,
    record: bool = False,
    shortcuts: Shortcuts = ALL,
    update_length: float = 0.0,
) -> BatchResult:
    """Simulate all robots; with `backward`, differentiate and, with `iterations`, teach them by updates of
    `update_length`.

    With `physical`, differentiate with respect to physics too. With `cotangents`, (T + 1, M, 2) for each
    robot, differentiate the sum of the positions times them instead of the loss.
    """
    task = prepare(
        morphologies, controllers, scene, physics,
        iterations=iterations, backward=backward, physical=physical, cotangents=cotangents, record=record,
        shortcuts=shortcuts, update_length=update_length,
    )  # fmt: skip
    return task()


def prepare(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None = None,
    *,
    iterations: int,
    backward: bool,
    physical: bool = False,
    cotangents: Sequence[FloatArray] | None = None,
    record: bool,
    shortcuts: Shortcuts,
    update_length: float = 0.0,
) -> Callable[[], BatchResult]:
    """Packs everything and returns the function that computes. Its second call starts from the weights that
    the first call learned."""
    real, robots = dtype(scene), len(morphologies)
    owns = list(physics) if physics is not None else physics_of(morphologies, scene, None)
    batch = pack(morphologies, controllers, scene, owns)
    others = physical or cotangents is not None
    if backward and learns_on_device(record, others, shortcuts == ALL):
        task = device_task(batch, scene, iterations, update_length)
        return lambda: _computed(batch, task)
    start()
    deaf = scene.sensing == "none"
    ring = RING if shortcuts.no_history and not (backward or record) else 0
    room = ring or scene.steps + 1
    ends = np.array([layout.workspace_ends(n, room) for n in batch.sizes])
    workspace = int(ends[:, -1].max())
    workers = _workers(robots, workspace, scene)
    memory = aligned(workspace * workers, real)
    losses, status = aligned(robots * (iterations + 1), real), aligned(robots, np.int32)
    best = aligned(len(batch.weights) if backward else 32, real)
    record_at = offsets([n.recorded_rows * (scene.steps + 1) if record else 0 for n in batch.sizes])
    slopes_at = offsets([n.slope_values if physical else 0 for n in batch.sizes])
    slopes = aligned(max(int(slopes_at[-1]), 16), real)
    wanted, wanted_at = pack_cotangents(cotangents, batch, scene)
    states = aligned(16 * max(int(record_at[-1]), 1), real)
    begins = (batch.cell_at, batch.mass_at, batch.motor_at, batch.weight_at, record_at, slopes_at, wanted_at)
    places = np.stack([*batch.counts, *(at[:-1] for at in begins)], axis=1)
    kernel = learning_kernel(scene.precision)
    weights, views = batch.weights, (memory.reshape(-1, width) for width in (1, 2, 4, 16, 32))
    launch = LearningLaunch(
        robots=robots, workers=workers, workspace=workspace,
        settings=RunSettings(
            steps=scene.steps, window=scene.window or scene.steps, iterations=iterations,
            backward=backward, recording=record,
            contact=_contact(scene, shortcuts.no_contact and not physical),
            staggered=scene.integrator == "second-order", physical=physical,
            cotangents_given=cotangents is not None, states=room, ring=ring - 1,
            listening=not (deaf and shortcuts.no_sensing), controlling=not shortcuts.no_controller,
            stopping=shortcuts.stop,
        ),
        scene=_numbers(scene), rule=_rule(scene, update_length), ground=_ground(scene, shortcuts.grid),
        cpgs=pack_cpgs(scene).reshape(-1, 16), queue=aligned(1, np.int32),
        places=packed(places, np.int32), ends=packed(ends, np.int32), pieces=ends.shape[1],
        arrays=RobotArrays(
            own=batch.own, start=batch.start.reshape(-1, 16), reference=batch.reference.reshape(-1, 16),
            velocity=batch.velocity.reshape(-1, 16), mask=_values_and_lanes(batch.mask),
            cell=batch.cell, motor=batch.motor, rest_length=batch.rest_length.reshape(-1, 16),
            stiffness_dt=batch.stiffness_dt.reshape(-1, 16),
        ),
        weights=WeightViews(weights, weights.reshape(-1, 16), weights.reshape(-1, 32)),
        best=best.reshape(-1, 32), work=WorkspaceViews(memory, *views),
        losses=losses, status=status, record=states.reshape(-1, 16), slopes=_values_and_lanes(slopes),
        cotangents=wanted.reshape(-1, 16),
    )  # fmt: skip

    def compute() -> BatchResult:
        launch.queue[0], losses[:], slopes[:] = 0, np.inf, 0.0
        prefer(scene.precision)
        kernel(launch)
        values = losses.astype(np.float64).reshape(robots, iterations + 1)
        found = physics_gradients(slopes, slopes_at, batch, scene, owns) if physical else []
        staggered = scene.integrator == "second-order"
        return BatchResult(batch, values, status, best, states, record_at, staggered, found)

    return compute


def device_task(batch: Batch, scene: Scene, iterations: int, update_length: float) -> device.Task:
    """What a device computes of a batch: gradients or, with `iterations`, updates of `update_length`."""
    settings = device.DeviceSettings(
        steps=scene.steps, first=0, end=scene.steps, window=scene.window or scene.steps, iteration=0,
        iterations=iterations, contact=_contact(scene, True),
        staggered=scene.integrator == "second-order", physical=False,
        listening=scene.sensing != "none", controlling=False, stopping=True,
    )  # fmt: skip
    b = batch
    arrays = device.DeviceArrays(
        b.own, b.start, b.reference, b.velocity, b.mask, b.cell, b.motor, b.rest_length, b.stiffness_dt
    )
    starts = (b.cell_at, b.mass_at, b.motor_at, b.weight_at)
    return device.Task(
        scene.precision, settings, _numbers(scene), _rule(scene, update_length), _ground(scene, True),
        pack_cpgs(scene), np.stack(b.counts, axis=1), np.stack([at[:-1] for at in starts], axis=1), arrays,
        b.weights,
    )  # fmt: skip


def _numbers(scene: Scene) -> SceneNumbers:
    return SceneNumbers(
        dt=scene.dt, actuation=scene.actuation, sense=0.0 if scene.sensing == "none" else _SENSE,
        softening=SOFTENING, resting=_RESTING * scene.dt, tiny=_TINY,
    )  # fmt: skip


def _rule(scene: Scene, length: float) -> UpdateRule:
    gain = _RELEASED_BIAS_GAIN if scene.weights == "released" else 1.0
    return UpdateRule(length=length, bias_gain=gain, least_gradient=_LEAST_GRADIENT)


def _ground(scene: Scene, grid: bool) -> GroundArrays:
    ground = pack_ground(scene, grid)
    return GroundArrays(
        level=-contact.FAR if scene.contact == "none" else ground.level, top=ground.top,
        segments=ground.segments, grid_from=ground.grid_from, cells_per_m=ground.cells_per_m,
        cell_segment=ground.cell_segment, last=len(ground.segments) // contact.SEGMENT - 1,
    )  # fmt: skip


def _computed(batch: Batch, task: device.Task) -> BatchResult:
    losses, status, best = compute_on_device(task)
    nothing = aligned(0, task.weights.dtype)
    nowhere = np.zeros(len(status) + 1, np.int32)
    return BatchResult(batch, losses.astype(np.float64), status, best, nothing, nowhere, False, [])


def _values_and_lanes(array: NDArray[Any]) -> ValuesAndLanes:
    return ValuesAndLanes(array, array.reshape(-1, 16))


def _contact(scene: Scene, without: bool) -> int:
    """Gradients of physics have no kernel of their own for free flight: it would take as long to compile as
    thousands of rollouts, and ground that nothing reaches does the same."""
    if scene.contact == "none":
        return contact.NO_CONTACT if without else contact.NO_SLIP
    return contact.NO_SLIP if scene.contact == "no-slip" else contact.FRICTION


def _workers(robots: int, workspace: int, scene: Scene) -> int:
    """Number of workers: limited by threads, robots, and 32-bit indices."""
    if workspace >= _INDEX_LIMIT:
        per_step = workspace / scene.steps
        raise InputError(
            "Scene.steps is too large for this robot",
            code="scene.too-many-steps",
            expected=f"at most {int(_INDEX_LIMIT / per_step):,}",
            found=f"{scene.steps:,}",
        )
    return min(worker_threads(), robots, (_INDEX_LIMIT - 1) // workspace)

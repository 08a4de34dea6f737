"""Simulating a batch of closed-loop robots: pack, launch the kernel, unpack. All other packages use this
module."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eldir.controller import Controller
from eldir.core.records import FloatArray
from eldir.engine.compiler import aligned
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
    SceneConstants,
    UpdateRule,
    ValuesAndLanes,
    WeightViews,
    WorkspaceViews,
)
from eldir.engine.pack import (
    ORIGIN,
    Batch,
    MotionCotangents,
    dtype,
    pack,
    pack_cotangents,
    pack_cpgs,
    packed,
    physics_gradients,
)
from eldir.engine.runtime import set_compile_options, start
from eldir.engine.shortcuts import ALL, RING, Shortcuts
from eldir.engine.threads import worker_threads
from eldir.engine.validity import NO_GRADIENT, OK
from eldir.errors import InputError
from eldir.morphology import Morphology, offsets
from eldir.physics import Physics, resolve_physics
from eldir.scene import SOFTENING, Scene

_MIN_LANDING_SPEED = 0.025
"""Least speed of a landing over the step [m/s2]: 1e-4 m/s at the released code's 4 ms. A constant would let
resting masses slide where gravity gives less in a step (docs/decisions/0001, as the next two)."""
_EPSILON, _MIN_GRADIENT = 1e-10, 1e-6
"""What keeps distances [m], speeds [m/s] and the gradient's norm from dividing by zero."""
_SENSING_SCALE = 0.05
_RELEASED_BIAS_GAIN = 3.0  # two constant inputs beside the bias move it by three gradients
INDEX_LIMIT = 2**31  # the kernel counts in 32 bits


@dataclass
class BatchResult:
    """The kernel's results, in the order of the robots."""

    batch: Batch
    losses: NDArray[np.float64]
    """Losses [m], shape (n, iterations + 1); infinite from the update at which a robot diverged."""
    status: NDArray[np.int32]
    """-1, -3 if the gradient is not finite, or the step at which the robot diverged."""
    growth: NDArray[np.float64]
    """Growth of the gradient in each reverse sweep (`eldir.engine.validity`), shape (n, iterations + 1); 0
    where there was none."""
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


@dataclass(frozen=True)
class BatchConfig:
    """What is computed of a batch."""

    iterations: int = 0
    """Number of updates of the controllers."""
    backward: bool = False
    """Whether controllers are differentiated and, with `iterations`, trained."""
    physics_gradients: bool = False
    """Whether the loss is differentiated with respect to physics too."""
    record: bool = False
    """Whether states are recorded."""
    keep: int = 0
    """Number of workspaces that keep a robot's states after a launch (`eldir.engine.kept`), or 0."""
    shortcuts: Shortcuts = ALL
    update_length: float = 0.0
    """Length of an update in the space of all weights."""


def run_batch(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None = None,
    config: BatchConfig = BatchConfig(),
    cotangents: Sequence[MotionCotangents] | None = None,
) -> BatchResult:
    """Simulate all robots and, as configured, differentiate or train them.

    With `cotangents`, differentiate the sum of each robot's motion times them instead of the loss.
    """
    return prepare(morphologies, controllers, scene, physics, config, cotangents)()


def prepare(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller],
    scene: Scene,
    physics: Sequence[Physics] | None = None,
    config: BatchConfig = BatchConfig(),
    cotangents: Sequence[MotionCotangents] | None = None,
) -> Callable[[], BatchResult]:
    """Packs everything and returns the function that computes. Its second call starts from the weights that
    the first call learned."""
    owns = list(physics) if physics is not None else resolve_physics(morphologies, scene, None)
    batch = pack(morphologies, controllers, scene, owns)
    other_gradients = config.physics_gradients or cotangents is not None
    if config.backward and learns_on_device(config.record, other_gradients, config.shortcuts == ALL):
        task = device_task(batch, scene, config.iterations, config.update_length)
        return lambda: _compute_on_device(batch, task)
    start()
    record_at = _record_offsets(batch, scene, config)
    launch = make_launch(batch, scene, config, cotangents, record_at)

    def compute() -> BatchResult:
        clear_results(launch)
        run_kernel(launch, scene)
        return read_results(launch, batch, scene, owns, record_at)

    return compute


def clear_results(launch: LearningLaunch) -> None:
    """Set the results to those of robots that were not simulated."""
    launch.losses[:], launch.physics_gradients.values[:], launch.growth[:] = np.inf, 0.0, 0.0


def run_kernel(launch: LearningLaunch, scene: Scene) -> None:
    """Compute the robots from `settings.kept_from` or 0 to `robots`."""
    launch.queue[0] = max(0, launch.settings.kept_from)
    set_compile_options(scene.precision)
    learning_kernel(scene.precision)(launch)


def read_results(
    launch: LearningLaunch,
    batch: Batch,
    scene: Scene,
    physics: Sequence[Physics],
    record_at: NDArray[np.int32],
) -> BatchResult:
    """The kernel's results."""
    settings, d_physics = launch.settings, launch.physics_gradients.values
    losses = launch.losses.astype(np.float64).reshape(len(physics), settings.iterations + 1)
    growth = launch.growth.astype(np.float64).reshape(losses.shape)
    gradients = []
    if settings.backward and settings.physics_gradients:
        _discard_overflows(launch, losses, batch)
        gradients = physics_gradients(d_physics, batch, scene, physics)
    staggered = scene.integrator == "second-order"
    return BatchResult(
        batch, losses, launch.status, growth, launch.best.ravel(), launch.record.ravel(), record_at,
        staggered, gradients,
    )  # fmt: skip


def _discard_overflows(launch: LearningLaunch, losses: NDArray[np.float64], batch: Batch) -> None:
    """Robots without a finite gradient of physics have none of weights and no loss either: all become as
    those of a robot that diverged."""
    at, d_physics, best = batch.physics_offsets(True), launch.physics_gradients.values, launch.best.ravel()
    for r, status in enumerate(launch.status):
        own = d_physics[at[r] : at[r + 1]]
        if status == OK and not np.isfinite(own).all():
            launch.status[r], losses[r] = NO_GRADIENT, np.inf
        if launch.status[r] != OK:
            own[:], best[batch.weight_at[r] : batch.weight_at[r + 1]] = 0.0, 0.0


def make_launch(
    batch: Batch,
    scene: Scene,
    config: BatchConfig,
    cotangents: Sequence[MotionCotangents] | None,
    record_at: NDArray[np.int32],
) -> LearningLaunch:
    """The kernel's arguments, with room for its results."""
    real, robots = dtype(scene), len(batch.sizes)
    ring = RING if config.shortcuts.no_history and not (config.backward or config.record) else 0
    states = ring or scene.steps + 1
    workspace_offsets = np.array([layout.workspace_offsets(n, states) for n in batch.sizes])
    workspace = int(workspace_offsets[:, -1].max())
    workers = _workers(robots, workspace, scene)
    memory = aligned(workspace * (config.keep or workers), real)
    physics_at = batch.physics_offsets(config.physics_gradients)
    packed_cotangents, cotangents_at, given = pack_cotangents(cotangents, batch.sizes, batch.grids, scene)
    begins = (
        batch.cell_at, batch.mass_at, batch.motor_at, batch.weight_at, record_at, physics_at, cotangents_at,
    )  # fmt: skip
    offsets_by_robot = np.stack([*batch.counts, *(at[:-1] for at in begins)], axis=1)
    weights = batch.weights
    return LearningLaunch(
        robots=robots, workers=workers, workspace=workspace,
        settings=_settings(scene, config, given, states, ring),
        scene=_scene_constants(scene), rule=_update_rule(scene, config.update_length),
        ground=_ground_arrays(scene, config.shortcuts.grid), cpgs=pack_cpgs(scene).reshape(-1, 16),
        queue=aligned(1, np.int32), offsets=packed(offsets_by_robot, np.int32),
        workspace_offsets=packed(workspace_offsets, np.int32), blocks=workspace_offsets.shape[1],
        arrays=RobotArrays(
            scalars=batch.scalars, start=batch.start.reshape(-1, 16),
            reference=batch.reference.reshape(-1, 16), velocity=batch.velocity.reshape(-1, 16),
            mask=_values_and_lanes(batch.mask), cell=batch.cell, motor=batch.motor,
            rest_length=batch.rest_length.reshape(-1, 16), stiffness_dt=batch.stiffness_dt.reshape(-1, 16),
        ),
        weights=WeightViews(weights, weights.reshape(-1, 16), weights.reshape(-1, 32)),
        best=aligned(len(weights) if config.backward else 32, real).reshape(-1, 32),
        work=WorkspaceViews(memory, *(memory.reshape(-1, width) for width in (1, 2, 4, 16, 32))),
        losses=aligned(robots * (config.iterations + 1), real), status=aligned(robots, np.int32),
        growth=aligned(robots * (config.iterations + 1), real),
        record=aligned(16 * max(int(record_at[-1]), 1), real).reshape(-1, 16),
        physics_gradients=_values_and_lanes(aligned(max(int(physics_at[-1]), 16), real)),
        cotangents=packed_cotangents.reshape(-1, 16),
    )  # fmt: skip


def _record_offsets(batch: Batch, scene: Scene, config: BatchConfig) -> NDArray[np.int32]:
    """Offsets of each robot's recorded states, in rows of 16 values."""
    states = scene.steps + 1 if config.record else 0
    return offsets([n.recorded_rows * states for n in batch.sizes])


def _settings(
    scene: Scene, config: BatchConfig, cotangents_given: int, states: int, ring: int
) -> RunSettings:
    shortcuts = config.shortcuts
    return RunSettings(
        steps=scene.steps, window=scene.window or scene.steps, iterations=config.iterations,
        kept_from=0 if config.keep else -1, resumed=False, backward=config.backward, record=config.record,
        contact=_contact_model(scene, shortcuts.no_contact and not config.physics_gradients),
        staggered=scene.integrator == "second-order", physics_gradients=config.physics_gradients,
        cotangents_given=cotangents_given, states=states, ring=ring - 1,
        closed_loop=not (scene.sensing == "none" and shortcuts.no_sensing),
        control_passive=not shortcuts.no_controller, stop_on_divergence=shortcuts.stop,
    )  # fmt: skip


def device_task(batch: Batch, scene: Scene, iterations: int, update_length: float) -> device.DeviceTask:
    """What a device computes of a batch: gradients or, with `iterations`, updates of `update_length`."""
    settings = device.DeviceSettings(
        steps=scene.steps, first=0, end=scene.steps, window=scene.window or scene.steps, iteration=0,
        iterations=iterations, contact=_contact_model(scene, True),
        staggered=scene.integrator == "second-order", physics_gradients=False,
        closed_loop=scene.sensing != "none", control_passive=False, stop_on_divergence=True,
    )  # fmt: skip
    b = batch
    arrays = device.DeviceArrays(
        b.scalars, b.start, b.reference, b.velocity, b.mask, b.cell, b.motor, b.rest_length, b.stiffness_dt
    )
    starts = (b.cell_at, b.mass_at, b.motor_at, b.weight_at)
    return device.DeviceTask(
        scene.precision, settings, _scene_constants(scene), _update_rule(scene, update_length),
        _ground_arrays(scene, True), pack_cpgs(scene), np.stack(b.counts, axis=1),
        np.stack([at[:-1] for at in starts], axis=1), arrays, b.weights,
    )  # fmt: skip


def _scene_constants(scene: Scene) -> SceneConstants:
    return SceneConstants(
        dt=scene.dt, actuation=scene.actuation,
        sensing_scale=0.0 if scene.sensing == "none" else _SENSING_SCALE,
        softening=SOFTENING, min_landing_speed=_MIN_LANDING_SPEED * scene.dt, epsilon=_EPSILON,
    )  # fmt: skip


def _update_rule(scene: Scene, length: float) -> UpdateRule:
    gain = _RELEASED_BIAS_GAIN if scene.weights == "released" else 1.0
    return UpdateRule(length=length, bias_gain=gain, min_gradient=_MIN_GRADIENT)


def _ground_arrays(scene: Scene, grid: bool) -> GroundArrays:
    ground = pack_ground(scene, grid)
    return GroundArrays(
        level=-contact.INFINITY if scene.contact == "none" else ground.level, max_height=ground.max_height,
        segments=ground.segments, grid_start=ground.grid_start, cells_per_m=ground.cells_per_m,
        cell_segment=ground.cell_segment, last_segment=len(ground.segments) // contact.SEGMENT_VALUES - 1,
    )  # fmt: skip


def _compute_on_device(batch: Batch, task: device.DeviceTask) -> BatchResult:
    losses, status, best, growth = compute_on_device(task)
    nothing = aligned(0, task.weights.dtype)
    nowhere = np.zeros(len(status) + 1, np.int32)
    return BatchResult(
        batch, losses.astype(np.float64), status, growth.astype(np.float64), best, nothing, nowhere, False, []
    )


def _values_and_lanes(array: NDArray[Any]) -> ValuesAndLanes:
    return ValuesAndLanes(array, array.reshape(-1, 16))


def _contact_model(scene: Scene, skip_free_flight: bool) -> int:
    """Gradients of physics have no kernel of their own for free flight: it would take as long to compile as
    thousands of rollouts, and ground that nothing reaches does the same."""
    if scene.contact == "none":
        return contact.NO_CONTACT if skip_free_flight else contact.NO_SLIP
    return contact.NO_SLIP if scene.contact == "no-slip" else contact.FRICTION


def _workers(robots: int, workspace: int, scene: Scene) -> int:
    """Number of workers: limited by threads, robots, and 32-bit indices."""
    if workspace >= INDEX_LIMIT:
        per_step = workspace / scene.steps
        raise InputError(
            "Scene.steps is too large for this robot",
            code="scene.too-many-steps",
            expected=f"at most {int(INDEX_LIMIT / per_step):,}",
            found=f"{scene.steps:,}",
        )
    return min(worker_threads(), robots, (INDEX_LIMIT - 1) // workspace)

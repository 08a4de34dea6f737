"""Arguments of the learning kernel, which the host fills, and the record of one robot that its element
functions read and write."""

from __future__ import annotations

from typing import Any, NamedTuple

from eldir.engine.grid import FAMILIES
from eldir.engine.kernels import layout
from eldir.engine.kernels.memory import Column, Memory, local
from eldir.engine.kernels.simd import Simd
from eldir.engine.runtime import Constant, Count, Integers, Lanes, Number, Ones, Pairs, Quads, Rows, Values


class RunSettings(NamedTuple):
    """What is computed."""

    steps: Count
    window: Count
    """Steps through which a gradient is traced back."""
    iterations: Count
    """Number of updates; with 0 the result is the gradient itself."""
    kept_from: Count
    """-1, or the first robot of this launch: every robot, not every worker, then has a workspace of its own,
    which outlasts the launch."""
    resumed: Count
    """Whether the states are in the workspaces of an earlier launch, and are not simulated again."""
    backward: Count
    """Whether gradients are computed."""
    record: Count
    """Whether states are written to `record`."""
    contact: Constant
    """`contact.NO_CONTACT`, `NO_SLIP` or `FRICTION`."""
    staggered: Constant
    """Whether positions are half a step ahead of velocities (docs/reference/accuracy.md)."""
    physics_gradients: Constant
    """Whether the gradient with respect to physics is computed."""
    cotangents_given: Count
    """1 where `cotangents` of positions replace the loss, 2 where there are those of velocities and
    activations too."""
    states: Count
    """Number of states that the history has room for."""
    ring: Count
    """-1, or one less than a power of two: the history keeps only the latest states."""
    closed_loop: Count
    """Whether the controller senses."""
    control_passive: Count
    """Whether the controller is computed for bodies without motors."""
    stop_on_divergence: Count
    """Whether a robot that has diverged is not simulated further."""


class SceneConstants(NamedTuple):
    """Constants of a scene that all robots share."""

    dt: Number
    """[s]"""
    actuation: Number
    """Relative change of a motor's rest length at activation 1."""
    sensing_scale: Number
    """Factor on the controller's sensed inputs."""
    softening: Number
    """Added to a length before dividing [m]."""
    min_landing_speed: Number
    """A mass that falls more slowly does not land [m/s]."""
    epsilon: Number
    """Keeps distances [m] and speeds [m/s] from dividing by 0."""


class UpdateRule(NamedTuple):
    """The update of the weights."""

    length: Number
    """Length of an update in the space of all weights."""
    bias_gain: Number
    """Factor on the gradient of the hidden bias."""
    min_gradient: Number
    """Added to the gradient's norm before dividing."""


class GroundArrays(NamedTuple):
    """The ground and the grid that is laid over it (`eldir.engine.ground`)."""

    level: Number
    """Height at its start [m]."""
    max_height: Number
    """No ground is higher [m]."""
    segments: Values
    """`contact.SEGMENT_VALUES` values each."""
    grid_start: Number
    """Start of the second cell of the grid [m]."""
    cells_per_m: Number
    cell_segment: Integers
    """The segment where a search in this cell begins."""
    last_segment: Count
    """Index of the last segment."""


class ValuesAndLanes(NamedTuple):
    """One array as single values and as 16 at a time."""

    values: Values
    lanes: Lanes


class WeightViews(NamedTuple):
    """One array as single values, and 16 and 32 at a time."""

    values: Values
    lanes: Lanes
    rows: Rows


class WorkspaceViews(NamedTuple):
    """One array as single values, and 1, 2, 4, 16 and 32 at a time."""

    values: Values
    ones: Ones
    pairs: Pairs
    quads: Quads
    lanes: Lanes
    rows: Rows


class RobotArrays(NamedTuple):
    """All robots, one after the other (`eldir.engine.pack.Batch`)."""

    scalars: Values
    """`layout.SCALARS` numbers of each robot."""
    start: Lanes
    reference: Lanes
    velocity: Lanes
    mask: ValuesAndLanes
    cell: Integers
    motor: Integers
    rest_length: Lanes
    stiffness_dt: Lanes


class LearningLaunch(NamedTuple):
    """The arguments of the learning kernel."""

    robots: Count
    workers: Count
    workspace: Count
    """Values of `work` for each worker or, where they are kept, for each robot."""
    settings: RunSettings
    scene: SceneConstants
    rule: UpdateRule
    ground: GroundArrays
    cpgs: Lanes
    """Outputs of the central pattern generators at every step."""
    queue: Integers
    """The next robot, one number that is shared by the workers."""
    offsets: Integers
    """`layout.RobotOffsets` of each robot."""
    workspace_offsets: Integers
    """Ends of the blocks of each robot's workspace (`layout.OffsetTable`)."""
    blocks: Count
    """Number of such blocks for each robot."""
    arrays: RobotArrays
    weights: WeightViews
    best: Rows
    """Best weights, or gradients where there are no iterations; laid out as the weights."""
    work: WorkspaceViews
    losses: Values
    """(robots, iterations + 1) [m]."""
    status: Integers
    """For each robot -1, -3 if its gradient is not finite, or the step at which it diverged."""
    record: Lanes
    growth: Values
    """(robots, iterations + 1): how many times larger the gradient of a position became in a reverse sweep
    than at its beginning; 0 where there was none."""
    physics_gradients: ValuesAndLanes
    """Gradients with respect to physics (`layout.PhysicsGradients`)."""
    cotangents: Lanes
    """For every state x, then y, by cell; where all are given, then vx, vy and activations as in `record`."""


class Ground(NamedTuple):
    """`GroundArrays`, and the contact model."""

    contact: Any
    """Known while compiling."""
    level: Any
    max_height: Any
    segments: Any
    grid_start: Any
    cells_per_m: Any
    cells: Any
    """Number of cells of the grid."""
    cell_segment: Any
    last_segment: Any


class Robot(NamedTuple):
    """One robot of a launch while it is simulated: constants of a step, body, ground, weights and memory.

    It is the argument of every element function, on the CPU and, with single values instead of `Column`s, on
    devices."""

    simd: Simd
    n: Any
    """`layout.Size`"""
    dt: Any
    decay: Any
    """Factor on this robot's velocities in one step."""
    gravity_dt: Any
    """Gravity times dt, for this robot [m/s]."""
    friction: Any
    """Coefficient of friction, for this robot."""
    max_squared_speed: Any
    """This robot has diverged where a mass is faster [m2/s2] (`eldir.engine.validity`)."""
    actuation: Any
    sensing_scale: Any
    softening: Any
    min_landing_speed: Any
    epsilon: Any
    closed_loop: Any
    control_passive: Any
    stop_on_divergence: Any
    staggered: Any
    """Known while compiling, as the next."""
    physics_gradients: Any
    ground: Ground
    inverse_count: Any
    """1/M."""
    start: Any
    """x, then y [m]."""
    reference: Any
    """Origin of the sensed displacements [m]; x, then y."""
    velocity: Any
    """Initial velocities [m/s]; x, then y."""
    mask: Any
    """1 for a cell with a mass, else 0."""
    cell: Any
    """Cell of each mass."""
    motor: Any
    """Index of each motor's spring among all springs."""
    rest_length: Any
    """[m]; by family and cell, like the next."""
    stiffness_dt: Any
    """Stiffness times dt [N s/m]; 0 where there is no spring."""
    cpgs: Any
    """Outputs of the central pattern generators at every step."""
    weights: Any = None
    """The controller."""
    work: Any = None
    """Scratch memory of the worker or, on a device, memory that the threads share."""
    d_physics: Any = None
    """Gradient with respect to this robot's physics (`layout.PhysicsGradients`)."""


class Cotangents(NamedTuple):
    """Gradients of another function with respect to all states; they replace the loss if `given`."""

    given: Any
    complete: Any
    """Whether those of velocities and activations are given too."""
    stride: Any
    """Rows of 16 values from one state to the next."""
    states: Column
    """For every state x, then y; where complete, then vx, vy and the activations."""


def constants(
    launch: Any, decay: Any, gravity_dt: Any, friction: Any, max_squared_speed: Any
) -> dict[str, Any]:
    """Fields of `Robot` that a launch, on the CPU or on a device, has for a robot with these scalars."""
    s, settings, g = launch.scene, launch.settings, launch.ground
    return {
        "dt": s.dt, "decay": decay, "gravity_dt": gravity_dt, "friction": friction,
        "max_squared_speed": max_squared_speed, "actuation": s.actuation,
        "sensing_scale": s.sensing_scale, "softening": s.softening,
        "min_landing_speed": s.min_landing_speed, "epsilon": s.epsilon,
        "closed_loop": settings.closed_loop, "control_passive": settings.control_passive,
        "stop_on_divergence": settings.stop_on_divergence, "staggered": settings.staggered,
        "physics_gradients": settings.physics_gradients,
        "ground": Ground(
            settings.contact, g.level, g.max_height, g.segments, g.grid_start, g.cells_per_m,
            g.cell_segment.shape[0], g.cell_segment, g.last_segment,
        ),
        "cpgs": launch.cpgs,
    }  # fmt: skip


def robot_view(
    simd: Simd, launch: LearningLaunch, scalars: tuple[Any, Any, Any, Any], n: layout.Size,
    inverse_count: Any, at: layout.RobotOffsets,
) -> Robot:  # fmt: skip
    """The robot whose arrays begin at these offsets."""
    own = launch.arrays
    start, reference, velocity = (
        Column(Memory(lanes=array), 2 * at.cell_at) for array in (own.start, own.reference, own.velocity)
    )
    return Robot(
        simd, n, **constants(launch, *scalars), inverse_count=inverse_count,
        start=start, reference=reference, velocity=velocity,
        mask=Column(Memory(values=own.mask.values, lanes=own.mask.lanes), at.cell_at),
        cell=Column(Memory(values=own.cell), at.mass_at), motor=Column(Memory(values=own.motor), at.motor_at),
        rest_length=Column(Memory(lanes=own.rest_length), FAMILIES * at.cell_at),
        stiffness_dt=Column(Memory(lanes=own.stiffness_dt), FAMILIES * at.cell_at),
    )  # fmt: skip


def workspace_view(launch: LearningLaunch, owner: Any, n: layout.Size, r: Any) -> layout.WorkerMemory:
    """The part of `launch.work` that belongs to this worker or robot, laid out for robot `r`."""
    table = layout.OffsetTable(launch.workspace_offsets, r * launch.blocks)
    settings, first = launch.settings, owner * launch.workspace
    return layout.workspace(Memory(*launch.work), first, n, settings.states, settings.ring, table)


def weights_view(launch: LearningLaunch, n: layout.Size, at: layout.RobotOffsets) -> layout.Weights:
    views = launch.weights
    memory = Memory(values=views.values, lanes=views.lanes, rows=views.rows)
    return layout.weights(memory, at.weight_at, n)


def physics_gradients_view(
    launch: LearningLaunch, n: layout.Size, at: layout.RobotOffsets
) -> layout.PhysicsGradients:
    views = launch.physics_gradients
    memory = Memory(values=views.values, lanes=views.lanes)
    return layout.physics_gradients(memory, at.physics_gradients_at, n)


def cotangents_view(launch: LearningLaunch, n: layout.Size, at: layout.RobotOffsets) -> Cotangents:
    given = launch.settings.cotangents_given
    complete = local(given >> 1)
    stride = local(2 * n.cell_rows + complete * (n.recorded_rows - 2 * n.cell_rows))
    return Cotangents(given, complete, stride, Column(Memory(lanes=launch.cotangents), at.cotangents_at))

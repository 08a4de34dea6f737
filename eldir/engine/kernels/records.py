"""What the learning kernel is launched with, and names for one robot's part of it."""

from __future__ import annotations

from typing import Any, NamedTuple

from eldir.engine.grid import FAMILIES
from eldir.engine.kernels import layout
from eldir.engine.kernels.memory import Column, Memory
from eldir.engine.launch import Constant, Count, Integers, Lanes, Number, Pairs, Quads, Rows, Values


class RunSettings(NamedTuple):
    """What is computed."""

    steps: Count
    window: Count
    """Steps through which a gradient is traced back."""
    iterations: Count
    """Updates; 0 asks for the gradient itself."""
    backward: Count
    """Whether gradients are computed."""
    recording: Count
    """Whether states are written to `record`."""
    contact: Constant
    """`contact.NO_CONTACT`, `NO_SLIP` or `FRICTION`."""
    staggered: Constant
    """Whether positions are half a step ahead of velocities (docs/reference/accuracy.md)."""
    physical: Constant
    """Whether the gradient with respect to physics is wanted."""
    cotangents_given: Count
    """Whether `cotangents` replace the loss."""
    states: Count
    """How many the history has room for."""
    ring: Count
    """-1, or one less than a power of two: the history keeps only the latest states."""
    listening: Count
    """Whether the controller senses."""
    controlling: Count
    """Whether it acts in bodies without motors."""
    stopping: Count
    """Whether nothing follows when a robot has blown up."""


class SceneNumbers(NamedTuple):
    """Numbers of a scene that all robots share."""

    dt: Number
    """[s]"""
    actuation: Number
    """Relative change of a motor's rest length at activation 1."""
    sense: Number
    """Scale of what is sensed."""
    softening: Number
    """Added to a length before dividing [m]."""
    resting: Number
    """A mass that falls more slowly does not land [m/s]."""
    tiny: Number
    """Added to a speed before dividing [m/s]."""


class UpdateRule(NamedTuple):
    """How weights follow the gradient."""

    length: Number
    """Of an update, in the space of all weights."""
    bias_gain: Number
    """How many gradients move the hidden bias."""
    least_gradient: Number
    """Added to the gradient's norm before dividing."""


class GroundArrays(NamedTuple):
    """The ground and the grid that is laid over it (`eldir.engine.ground`)."""

    level: Number
    """Height where it begins [m]."""
    top: Number
    """No ground is higher [m]."""
    segments: Values
    """`contact.SEGMENT` values each."""
    grid_from: Number
    """[m]"""
    cells_per_m: Number
    cell_segment: Integers
    """The segment where a search in this cell begins."""
    last: Count
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
    """One array as single values, and 2, 4, 16 and 32 at a time."""

    values: Values
    pairs: Pairs
    quads: Quads
    lanes: Lanes
    rows: Rows


class RobotArrays(NamedTuple):
    """All robots, one after the other (`eldir.engine.pack.Batch`)."""

    own: Values
    """`layout.OWN` numbers of each robot."""
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
    """Values of `work` for each worker."""
    settings: RunSettings
    scene: SceneNumbers
    rule: UpdateRule
    ground: GroundArrays
    cpgs: Lanes
    """Outputs of the central pattern generators at every step."""
    queue: Integers
    """The next robot, one number that is shared by the workers."""
    places: Integers
    """`layout.Place` of each robot."""
    ends: Integers
    """Where the pieces of each robot's workspace end."""
    pieces: Count
    """How many these are for each robot."""
    arrays: RobotArrays
    weights: WeightViews
    best: Rows
    """Best weights, or gradients where there are no iterations; laid out as the weights."""
    work: WorkspaceViews
    losses: Values
    """(robots, iterations + 1) [m]."""
    status: Integers
    """Of each robot: -1, or the step at which it blew up."""
    record: Lanes
    slopes: ValuesAndLanes
    """Gradients with respect to physics (`layout.Slopes`)."""
    cotangents: Lanes
    """Of every state: x, then y, by cell."""


class Law(NamedTuple):
    """Numbers that a step of one robot needs."""

    dt: Any
    decay: Any
    """Factor on this robot's velocities in one step."""
    gravity_dt: Any
    """This robot's."""
    friction: Any
    """This robot's, where the ground lets slip."""
    actuation: Any
    sense: Any
    softening: Any
    resting: Any
    tiny: Any
    listening: Any
    controlling: Any
    stopping: Any
    staggered: Any
    physical: Any


class GroundView(NamedTuple):
    """`GroundArrays`, and what kind of ground it is."""

    contact: Any
    """Known while compiling."""
    level: Any
    top: Any
    segments: Any
    grid_from: Any
    cells_per_m: Any
    cells: Any
    """How many cells the grid has."""
    cell_segment: Any
    last: Any


class Cotangents(NamedTuple):
    """What takes the loss's place where it is `given`: the gradient of something with respect to all
    positions."""

    given: Any
    positions: Column
    """Of every state x, then y."""


class RobotView(NamedTuple):
    """One robot."""

    n: layout.Size
    per_mass: Any
    """1/M."""
    start: Column
    """x, then y."""
    reference: Column
    """What sensed displacements are relative to; x, then y."""
    velocity: Column
    """In the beginning; x, then y."""
    mask: Column
    """1 for a cell with a mass, else 0."""
    cell: Column
    """Of each mass."""
    motor: Column
    """Where the spring of each motor stands among all springs."""
    rest_length: Column
    stiffness_dt: Column
    """0 where there is no spring."""
    cpgs: Any


def law_of(launch: LearningLaunch, decay: Any, gravity_dt: Any, friction: Any) -> Law:
    scene, settings = launch.scene, launch.settings
    return Law(
        scene.dt, decay, gravity_dt, friction, scene.actuation, scene.sense, scene.softening, scene.resting,
        scene.tiny, settings.listening, settings.controlling, settings.stopping, settings.staggered,
        settings.physical,
    )  # fmt: skip


def ground_of(launch: LearningLaunch) -> GroundView:
    g = launch.ground
    return GroundView(
        launch.settings.contact, g.level, g.top, g.segments, g.grid_from, g.cells_per_m,
        g.cell_segment.shape[0], g.cell_segment, g.last,
    )  # fmt: skip


def robot_of(launch: LearningLaunch, n: layout.Size, per_mass: Any, at: layout.Place) -> RobotView:
    own = launch.arrays
    return RobotView(
        n, per_mass,
        Column(Memory(lanes=own.start), 2 * at.cell_at), Column(Memory(lanes=own.reference), 2 * at.cell_at),
        Column(Memory(lanes=own.velocity), 2 * at.cell_at),
        Column(Memory(values=own.mask.values, lanes=own.mask.lanes), at.cell_at),
        Column(Memory(values=own.cell), at.mass_at), Column(Memory(values=own.motor), at.motor_at),
        Column(Memory(lanes=own.rest_length), FAMILIES * at.cell_at),
        Column(Memory(lanes=own.stiffness_dt), FAMILIES * at.cell_at), launch.cpgs,
    )  # fmt: skip


def workspace_of(launch: LearningLaunch, worker: Any, n: layout.Size, r: Any) -> layout.WorkerMemory:
    """The part of `launch.work` that belongs to this worker, laid out for robot `r`."""
    ends = layout.Ends(launch.ends, r * launch.pieces)
    settings, first = launch.settings, worker * launch.workspace
    return layout.workspace(Memory(*launch.work), first, n, settings.states, settings.ring, ends)


def weights_of(launch: LearningLaunch, n: layout.Size, at: layout.Place) -> layout.Weights:
    views = launch.weights
    memory = Memory(values=views.values, lanes=views.lanes, rows=views.rows)
    return layout.weights(memory, at.weight_at, n)


def slopes_of(launch: LearningLaunch, n: layout.Size, at: layout.Place) -> layout.Slopes:
    memory = Memory(values=launch.slopes.values, lanes=launch.slopes.lanes)
    return layout.slopes(memory, at.slopes_at, n)


def cotangents_of(launch: LearningLaunch, at: layout.Place) -> Cotangents:
    positions = Column(Memory(lanes=launch.cotangents), at.cotangents_at)
    return Cotangents(launch.settings.cotangents_given, positions)

"""Arguments of the learning kernel: the host fills these records and the kernel reads them."""

from __future__ import annotations

from typing import NamedTuple

from eldir.engine.launch import Constant, Count, Integers, Lanes, Number, Ones, Pairs, Quads, Rows, Values


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
    """Number of states that the history has room for."""
    ring: Count
    """-1, or one less than a power of two: the history keeps only the latest states."""
    listening: Count
    """Whether the controller senses."""
    controlling: Count
    """Whether it acts in bodies without motors."""
    stopping: Count
    """Whether a robot that has blown up is not simulated further."""


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
    """The update of the weights."""

    length: Number
    """Length of an update in the space of all weights."""
    bias_gain: Number
    """Factor on the gradient of the hidden bias."""
    least_gradient: Number
    """Added to the gradient's norm before dividing."""


class GroundArrays(NamedTuple):
    """The ground and the grid that is laid over it (`eldir.engine.ground`)."""

    level: Number
    """Height at its start [m]."""
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
    """One array as single values, and 1, 2, 4, 16 and 32 at a time."""

    values: Values
    ones: Ones
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
    """Ends of the pieces of each robot's workspace."""
    pieces: Count
    """Number of such pieces for each robot."""
    arrays: RobotArrays
    weights: WeightViews
    best: Rows
    """Best weights, or gradients where there are no iterations; laid out as the weights."""
    work: WorkspaceViews
    losses: Values
    """(robots, iterations + 1) [m]."""
    status: Integers
    """For each robot -1, or the step at which it blew up."""
    record: Lanes
    slopes: ValuesAndLanes
    """Gradients with respect to physics (`layout.Slopes`)."""
    cotangents: Lanes
    """For every state x, then y, by cell."""

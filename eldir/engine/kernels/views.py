"""Names for one robot's part of a launch, which the learning kernel's functions read and write."""

from __future__ import annotations

from typing import Any, NamedTuple

from eldir.engine.grid import FAMILIES
from eldir.engine.kernels import layout
from eldir.engine.kernels.learning_launch import LearningLaunch
from eldir.engine.kernels.memory import Column, Memory


class Law(NamedTuple):
    """Numbers that a step of one robot needs."""

    dt: Any
    decay: Any
    """Factor on this robot's velocities in one step."""
    gravity_dt: Any
    """Gravity times dt, for this robot [m/s]."""
    friction: Any
    """Coefficient of friction, for this robot."""
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
    """Number of cells of the grid."""
    cell_segment: Any
    last: Any


class Cotangents(NamedTuple):
    """Gradients of another function with respect to all positions; they replace the loss if `given`."""

    given: Any
    positions: Column
    """For every state x, then y."""


class RobotView(NamedTuple):
    """One robot."""

    n: layout.Size
    per_mass: Any
    """1/M."""
    start: Column
    """x, then y."""
    reference: Column
    """Origin of the sensed displacements; x, then y."""
    velocity: Column
    """Initial velocities; x, then y."""
    mask: Column
    """1 for a cell with a mass, else 0."""
    cell: Column
    """Cell of each mass."""
    motor: Column
    """Index of each motor's spring among all springs."""
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

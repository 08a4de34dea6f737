"""Arguments of the device's kernels, and the task of a batch, from which they are filled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eldir.engine.kernels.learning_launch import GroundArrays, SceneNumbers, UpdateRule
from eldir.engine.launch import Constant, Count, Integers
from eldir.engine.launch import Values as Numbers


class DeviceSettings(NamedTuple):
    """What is computed."""

    steps: Count
    first: Count
    """The launch computes steps `first` to `end` - 1."""
    end: Count
    window: Count
    """Steps through which a gradient is traced back."""
    iteration: Count
    """Number of updates that were made."""
    iterations: Count
    """Updates; 0 asks for the gradient itself."""
    contact: Constant
    """`contact.NO_CONTACT`, `NO_SLIP` or `FRICTION`."""
    staggered: Constant
    physical: Constant
    listening: Count
    """Whether the controller senses."""
    controlling: Count
    stopping: Count


class DeviceArrays(NamedTuple):
    """All robots of a batch, one after the other (`eldir.engine.pack.Batch`)."""

    own: Numbers
    start: Numbers
    reference: Numbers
    velocity: Numbers
    mask: Numbers
    cell: Integers
    motor: Integers
    rest_length: Numbers
    stiffness_dt: Numbers


class DeviceLaunch(NamedTuple):
    """The arguments of every kernel of a device."""

    workers: Count
    """Blocks: one for each robot."""
    first: Count
    """Row of `places` of the first robot."""
    order: Count
    """Of the threads, on the CPU: ASCENDING or DESCENDING (`block`)."""
    settings: DeviceSettings
    scene: SceneNumbers
    rule: UpdateRule
    ground: GroundArrays
    cpgs: Numbers
    """Outputs of the central pattern generators at every step, 16 each."""
    places: Integers
    """`layout.Place` of each robot, in the order in which they are computed."""
    arrays: DeviceArrays
    weights: Numbers
    best: Numbers
    """Best weights, or gradients where there are no iterations; laid out as weights, like the next two."""
    transposed: Numbers
    """Transposed weights."""
    g_weights: Numbers
    history: Numbers
    carry: Numbers
    """State or gradient of every cell, which one launch leaves to the next."""
    losses: Numbers
    """(robots, iterations + 1) [m]."""
    status: Integers
    """For each robot -1, or the step at which it blew up."""
    shared: Numbers
    """The blocks' shared memory on the CPU, else empty."""


class Task(NamedTuple):
    """A batch of robots as packed for the CPU, and what is to be computed of it."""

    precision: str
    settings: DeviceSettings
    scene: SceneNumbers
    rule: UpdateRule
    ground: GroundArrays
    cpgs: NDArray
    sizes: NDArray[np.int32]
    """Masses, motors, cells and reach of every robot, shape (n, 4)."""
    at: NDArray[np.int32]
    """Offsets of its cells, masses, motors and weights, shape (n, 4)."""
    arrays: DeviceArrays
    weights: NDArray


class Outcome(NamedTuple):
    """As in `eldir.engine.batch.BatchResult`."""

    losses: NDArray
    status: NDArray[np.int32]
    best: NDArray

"""Arguments of the device's kernels, the task of a batch, from which they are filled, and its result."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eldir.engine.kernels.learning_launch import GroundArrays, SceneConstants, UpdateRule
from eldir.engine.runtime import Constant, Count, Integers
from eldir.engine.runtime import Values as Numbers

DEVICE, ASCENDING, DESCENDING = 0, 1, -1
"""Order of the threads of a block: all at once, or one after the other."""


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
    """Number of updates; with 0 the result is the gradient itself."""
    contact: Constant
    """`contact.NO_CONTACT`, `NO_SLIP` or `FRICTION`."""
    staggered: Constant
    physics_gradients: Constant
    closed_loop: Count
    """Whether the controller senses."""
    control_passive: Count
    stop_on_divergence: Count


class DeviceArrays(NamedTuple):
    """All robots of a batch, one after the other (`eldir.engine.pack.Batch`)."""

    scalars: Numbers
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
    """Row of `offsets` of the first robot."""
    order: Count
    """Order of the threads: `DEVICE`, or on the CPU `ASCENDING` or `DESCENDING`."""
    settings: DeviceSettings
    scene: SceneConstants
    rule: UpdateRule
    ground: GroundArrays
    cpgs: Numbers
    """Outputs of the central pattern generators at every step, 16 each."""
    offsets: Integers
    """`layout.DeviceOffsets` of each robot, in the order in which they are computed."""
    arrays: DeviceArrays
    weights: Numbers
    best: Numbers
    """Best weights, or gradients where there are no iterations; laid out as weights, like the next two."""
    transposed: Numbers
    """Transposed weights."""
    g_weights: Numbers
    history: Numbers
    carry: Numbers
    """State or gradient of every cell, which one launch leaves to the next, and the cell's greatest
    gradient."""
    losses: Numbers
    """(robots, iterations + 1) [m]."""
    growth: Numbers
    """(robots, iterations + 1), as in `learning_launch.LearningLaunch`."""
    status: Integers
    """For each robot -1, -3 if its gradient overflowed, or the step at which it diverged."""
    shared: Numbers
    """The blocks' shared memory on the CPU, else empty."""


class DeviceTask(NamedTuple):
    """A batch of robots as packed for the CPU, and what is computed of it."""

    precision: str
    settings: DeviceSettings
    scene: SceneConstants
    rule: UpdateRule
    ground: GroundArrays
    cpgs: NDArray
    sizes: NDArray[np.int32]
    """Masses, motors, cells and reach of every robot, shape (n, 4)."""
    offsets: NDArray[np.int32]
    """Offsets of its cells, masses, motors and weights, shape (n, 4)."""
    arrays: DeviceArrays
    weights: NDArray


class DeviceResult(NamedTuple):
    """As in `eldir.engine.batch.BatchResult`."""

    losses: NDArray
    status: NDArray[np.int32]
    best: NDArray
    growth: NDArray

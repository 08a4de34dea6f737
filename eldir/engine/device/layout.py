"""The memory layout of a robot on a device: its history, and the memory that its block of threads shares.

A robot's weights, springs and start lie as on the CPU (`eldir.engine.pack`). Its history is what the reverse
sweep and the weights' gradient need of each step, side by side.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from eldir.controller import HIDDEN
from eldir.engine.compiler import subscript, ti
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels.layout import CPG_ROWS, Forces, Gradient, GroundSegments, blocks
from eldir.engine.kernels.memory import local

PARTS = 8
"""Partial sums of what the threads of a block add up."""
ROWS = 8
"""Rows of weights that a thread loads before it multiplies them."""
WARP = 32
"""Threads that run in lockstep."""
STATE = 4
"""x, y, vx, vy."""
LARGEST_GRADIENT = 6
"""Where the carry holds the greatest gradient of a position in a reverse sweep."""
CARRY = LARGEST_GRADIENT + 1
"""Values of a mass that one launch leaves to the next: its state, or the gradients of it, the two
velocities of the adjacent step, and the greatest gradient of its position."""


class Values(NamedTuple):
    """`values[i]` and `values.each[i]` are element `first + i` of an array."""

    array: Any
    first: Any

    def __getitem__(self, i: Any) -> Any:
        return subscript(None, self.array, self.first + i)

    @property
    def each(self) -> Values:
        return self

    def __add__(self, count: Any) -> Values:  # type: ignore[override]
        return Values(self.array, self.first + count)


class SharedMemory:
    """Arrays that the threads of a block share: in the device's shared memory or, on the CPU, one after the
    other in `array` from `first` on. `used` counts their values. Without a type `real` it only counts."""

    def __init__(self, real: Any = None, on_device: bool = True, array: Any = None, first: Any = 0):
        self._real, self._on_device = real, on_device
        self._array, self._first = array, first
        self.used = 0

    def allocate(self, count: int) -> Values:
        first, self.used = self.used, self.used + count
        if self._on_device and self._real is not None:
            return Values(ti.simt.block.SharedArray((count,), self._real), 0)
        return Values(self._array, self._first + first)


class DeviceOffsets(NamedTuple):
    """Size of a robot, and the offset of each of its arrays."""

    robot: Any
    """Its number in the batch."""
    masses: Any
    motors: Any
    cells: Any
    reach: Any
    cell_at: Any
    mass_at: Any
    motor_at: Any
    weight_at: Any
    history_at: Any


class Size(NamedTuple):
    """Size of one robot. Rows are single cells."""

    masses: Any
    motors: Any
    cell_rows: Any
    reach: Any
    inputs: Any
    """Rows of W1: pattern generators, then x, y, vx, vy of each mass; a multiple of 8."""
    padded_motors: Any

    @property
    def bias(self) -> Any:
        """Where the hidden units' bias begins among the weights."""
        return self.inputs * HIDDEN

    @property
    def w2(self) -> Any:
        return self.bias + HIDDEN

    @property
    def b2(self) -> Any:
        return self.w2 + self.padded_motors * HIDDEN

    @property
    def weights(self) -> Any:
        return self.b2 + self.padded_motors

    @property
    def input_values(self) -> Any:
        """The inputs and, padded to eight, a 1, whose weight is the hidden units' bias."""
        return self.inputs + 8

    @property
    def step_values(self) -> Any:
        """Values of the history for one step."""
        return STATE * self.cell_rows + 2 * HIDDEN + self.padded_motors + self.input_values


def size(masses: Any, motors: Any, cells: Any, reach: Any) -> Size:
    inputs, padded = CPG_ROWS + 8 * blocks(masses, 2), HIDDEN * blocks(motors, HIDDEN)
    return Size(masses, motors, cells, reach, local(inputs), local(padded))


class StepHistory(NamedTuple):
    """What the history keeps of one step."""

    x: Values
    y: Values
    wx: Values
    wy: Values
    hidden: Values
    hidden_delta: Values
    """Gradient before tanh."""
    action: Values
    """Activations; in the reverse sweep replaced by their gradients before tanh."""
    inputs: Values
    """`Size.input_values` values."""


def step_history(history: Any, at: DeviceOffsets, n: Size, t: Any) -> StepHistory:
    start = Values(history, local(at.history_at + t * n.step_values))
    x, y, wx, wy = (start + c * n.cell_rows for c in range(4))
    hidden = start + 4 * n.cell_rows
    action = hidden + 2 * HIDDEN
    return StepHistory(x, y, wx, wy, hidden, hidden + HIDDEN, action, action + n.padded_motors)


class Shared(NamedTuple):
    """Memory that the threads of a robot share: the device's counterpart of `kernels.layout.Scratch`."""

    x: Values
    y: Values
    vx: Any
    vy: Any
    forces: Forces
    activations: Values
    g: Any
    inputs: Values
    """Of the controller; in the reverse sweep the deltas of the motors."""
    sensed: Any
    """Gradients of what was sensed, by cell: x, y, vx, vy."""
    partial: Values
    """One value of each thread."""
    sums: Values
    """Partial sums of two arrays."""
    hidden: Values
    hidden_delta: Any
    adjacent_vx: Any
    """With the second-order integrator: velocities a step earlier; in the reverse sweep, gradients of the
    velocities that were sensed a step later."""
    adjacent_vy: Any
    segments_below: Any
    """The segment of ground that was last found below each mass."""
    segments_hit: Any
    """The segment that each mass hits."""
    search_x: Any
    """The x at which the ground is searched."""

    def for_thread(self, thread: Any) -> Shared:
        """The same with the entries of one thread for its search of the ground."""
        hit = GroundSegments(*(column + thread for column in self.segments_hit))
        return self._replace(segments_hit=hit, search_x=self.search_x + thread)

    @property
    def carry(self) -> tuple[Values, ...]:
        """What one launch of the forward pass leaves to the next, in the order of `DeviceLaunch.carry`."""
        return self.x, self.y, self.vx, self.vy, *self._adjacent

    @property
    def gradient_carry(self) -> tuple[Values, ...]:
        """The same for the reverse sweep."""
        return self.g.x, self.g.y, self.g.vx, self.g.vy, *self._adjacent

    @property
    def _adjacent(self) -> tuple[Values, ...]:
        return () if self.adjacent_vx is None else (self.adjacent_vx, self.adjacent_vy)

    @property
    def g_activations(self) -> Values:
        """Each spring's activation is overwritten by its gradient."""
        return self.activations


def forward_memory(memory: SharedMemory, threads: int, friction: bool, staggered: bool) -> Shared:
    """Shared memory of a robot's forward pass."""
    x, forces = memory.allocate(STATE * threads), memory.allocate(2 * FAMILIES * threads)
    activations, inputs = memory.allocate(FAMILIES * threads), memory.allocate(CPG_ROWS + 4 * threads + 8)
    partial, sums, hidden = memory.allocate(threads), memory.allocate(2 * PARTS), memory.allocate(HIDDEN)
    return Shared(
        x, x + threads, x + 2 * threads, x + 3 * threads,
        Forces(forces, forces + FAMILIES * threads, threads), activations, None, inputs, None, partial, sums,
        hidden, None, *_adjacent(memory, threads, staggered), *_ground(memory, threads, friction),
    )  # fmt: skip


def reverse_memory(memory: SharedMemory, threads: int, friction: bool, staggered: bool) -> Shared:
    """Shared memory of a robot's reverse sweep. Where the springs no longer need a step's positions and the
    gradients of its velocities, the motors' deltas lie; where their forces were, what was sensed."""
    x, forces = memory.allocate(8 * threads), memory.allocate(2 * FAMILIES * threads)
    activations = memory.allocate(FAMILIES * threads)
    partial, sums, hidden = memory.allocate(threads), memory.allocate(2 * PARTS), memory.allocate(2 * HIDDEN)
    return Shared(
        x, x + threads, None, None, Forces(forces, forces + FAMILIES * threads, threads), activations,
        Gradient(*(x + k * threads for k in range(2, 8))), x, forces, partial, sums,  # type: ignore[arg-type]
        hidden, hidden + HIDDEN, *_adjacent(memory, threads, staggered), *_ground(memory, threads, friction),
    )  # fmt: skip


def _adjacent(memory: SharedMemory, threads: int, staggered: bool) -> tuple[Any, Any]:
    if not staggered:
        return None, None
    x = memory.allocate(2 * threads)
    return x, x + threads


def _ground(memory: SharedMemory, threads: int, friction: bool) -> tuple[Any, Any, Any]:
    """The segments that masses remember, and those that they find; nothing without friction."""
    if not friction:
        return None, None, None
    fields = len(GroundSegments._fields)
    columns = memory.allocate((2 * fields + 1) * threads)
    below = GroundSegments(*(columns + k * threads for k in range(fields)))  # type: ignore[arg-type]
    hit = GroundSegments(*(columns + (fields + k) * threads for k in range(fields)))  # type: ignore[arg-type]
    return below, hit, columns + 2 * fields * threads

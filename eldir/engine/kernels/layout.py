"""The memory layout of a robot: its weights, its states over time, their gradients, and scratch memory.

All of this is resolved while the kernel is compiled: `now.x[i]` is nothing but `lanes[now // 16 + i]`. The
same functions, called with plain numbers, say how much memory a robot needs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from eldir.controller import HIDDEN
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels.memory import Column, Memory, OffsetView, local

LANES = 16
"""Number of masses that are computed at a time."""
CPG_ROWS = 16
"""The ten central pattern generators, padded."""
SCALARS = 4
"""Number of scalars of a robot: decay of its velocities and gravity in a step, friction, greatest squared
speed."""
CHUNK = 50
"""Number of steps whose weight gradients are summed as one matrix product, and after which the reverse
sweep looks how large the gradient of the positions has become."""


class RobotOffsets(NamedTuple):
    """Size of a robot, and the offset of each of its arrays."""

    masses: Any
    motors: Any
    cells: Any
    reach: Any
    cell_at: Any
    mass_at: Any
    motor_at: Any
    weight_at: Any
    record_at: Any
    physics_gradients_at: Any
    cotangents_at: Any


def read_row(table: Any, r: Any, kind: Any = RobotOffsets) -> Any:
    """Row `r` of a table with one row for each robot, as a tuple of this kind."""
    row = OffsetView(table, r * len(kind._fields))
    return kind(*(local(row[k]) for k in range(len(kind._fields))))


class Size(NamedTuple):
    """Size of one robot in whole vectors: cells of its grid 16 at a time, motors 32 at a time."""

    masses: Any
    motors: Any
    reach: Any
    """Reach of its grid, see `Grid`."""
    mass_pairs: Any
    mass_blocks: Any
    """Blocks of eight masses, which are 32 inputs of the controller."""
    cell_rows: Any
    guard_rows: Any
    """Rows of zeros between forces, which sums reach into."""
    motor_blocks: Any

    @property
    def cells(self) -> Any:
        return LANES * self.cell_rows

    @property
    def padded_rows(self) -> Any:
        return HIDDEN * blocks(self.cell_rows, HIDDEN)

    @property
    def padded_motors(self) -> Any:
        return HIDDEN * self.motor_blocks

    @property
    def state_values(self) -> Any:
        return 6 * self.cells + self.padded_rows + HIDDEN + self.padded_motors

    @property
    def recorded_rows(self) -> Any:
        """Rows of 16 values that hold one state's x, y, vx, vy and activations."""
        return 4 * self.cell_rows + 2 * self.motor_blocks

    @property
    def physics_values(self) -> Any:
        """Number of values of `PhysicsGradients`."""
        return (2 * FAMILIES + 2) * self.cells + 3 * LANES

    @property
    def input_values(self) -> Any:
        """Number of values that the controller receives: what it senses, by cell, and the pattern
        generators."""
        return 4 * self.cells + CPG_ROWS

    @property
    def inputs(self) -> Any:
        """Rows of W1: pattern generators, then x, y, vx, vy of each mass."""
        return CPG_ROWS + 8 * self.mass_pairs

    @property
    def weight_rows(self) -> Any:
        """Rows of 32 values."""
        return self.inputs + 1 + self.padded_motors + self.motor_blocks


def size(masses: Any, motors: Any, cells: Any, reach: Any) -> Size:
    masses, motors, reach = (local(n) for n in (masses, motors, reach))
    counts = (masses, 2), (masses, 8), (cells, LANES), (reach + 1, LANES), (motors, HIDDEN)
    return Size(masses, motors, reach, *(local(blocks(n, k)) for n, k in counts))


def blocks(count: Any, width: int) -> Any:
    """Number of vectors that hold `count` values. Widths are powers of two, because a shift is fast."""
    return (count + (width - 1)) >> (width.bit_length() - 1)


class Weights(NamedTuple):
    """A controller, or its gradient: a row for every input, then for every output."""

    cpgs: Column
    w1: Column
    """Weights of what is sensed: x, y, vx, vy of each mass."""
    b1: Column
    w2: Column
    b2: Column
    all: Column


def weights(memory: Memory, first: Any, n: Size) -> Weights:
    whole = Column(memory, first)
    b1 = Column(memory, local(first + n.inputs * HIDDEN))
    w2 = b1 + HIDDEN
    return Weights(whole, whole + CPG_ROWS * HIDDEN, b1, w2, w2 + n.padded_motors * HIDDEN, whole)


class State(NamedTuple):
    """One instant: the state before a step, and the intermediate results of the step."""

    x: Column
    y: Column
    vx: Column
    vy: Column
    wx: Column
    """Velocity after the springs, before contact."""
    wy: Column
    contact: Column
    """Whether any of 16 masses hit the ground; used with friction."""
    hidden: Column
    action: Column
    """Activations of the motors, -1 to 1."""


class StateHistory(NamedTuple):
    """The states of one robot, `stride` values apart; all of them, or the latest in turn."""

    memory: Memory
    first: Any
    stride: Any
    n: Size
    ring: Any
    """-1, or one less than a power of two: how many states there is room for."""

    def at(self, t: Any) -> State:
        start = Column(self.memory, local(self.first + (t & self.ring) * self.stride))
        x, y, vx, vy, wx, wy = (start + c * self.n.cells for c in range(6))
        contact = start + 6 * self.n.cells
        hidden = contact + self.n.padded_rows
        return State(x, y, vx, vy, wx, wy, contact, hidden, hidden + HIDDEN)


class Gradient(NamedTuple):
    """Gradient of the loss with respect to one state. Values read beyond wx and wy are discarded, but must
    belong to this robot."""

    wx: Column
    wy: Column
    x: Column
    y: Column
    vx: Column
    vy: Column


class PhysicsGradients(NamedTuple):
    """Gradient of the loss with respect to one robot's physics, where it is requested."""

    stiffness_dt: Column
    """By family and cell, like the next."""
    rest_length: Column
    velocity: Column
    """By cell; x, then y."""
    decay: Column
    """Sixteen values to be summed, like the next two."""
    gravity_dt: Column
    friction: Column


def physics_gradients(memory: Memory, first: Any, n: Size) -> PhysicsGradients:
    stiffness = Column(memory, first)
    rest_length = stiffness + FAMILIES * n.cells
    velocity = rest_length + FAMILIES * n.cells
    decay = velocity + 2 * n.cells
    return PhysicsGradients(stiffness, rest_length, velocity, decay, decay + LANES, decay + 2 * LANES)


class Forces(NamedTuple):
    """Impulses on the masses at the far ends of springs, by the cell of the near end; rows of zeros before
    it."""

    x: Any
    y: Any
    stride: Any
    """Values from one family of springs to the next."""

    def family(self, family: Any) -> Forces:
        return Forces(self.x + family * self.stride, self.y + family * self.stride, self.stride)


class GroundSegments(NamedTuple):
    """Segments of ground: between which x they lie, and their lines (`contact.py`)."""

    start: Column
    end: Column
    slope: Column
    intercept: Column
    level: Column
    nx: Column
    """Unit normal."""
    ny: Column


class Scratch(NamedTuple):
    """A worker's memory beside the history."""

    inputs: Column
    w1_transposed: Column
    w2_transposed: Column
    activations: Column
    """Activation of each spring, by family and cell; 0 for a passive one."""
    g_activations: Column
    forces: Forces
    g: Gradient
    g_inputs: Column
    """x, y, vx, vy of each mass; then the same by cell."""
    g_sensed: Column
    segments_below: GroundSegments
    """The segment of ground that was last found below each mass."""
    segments_hit: GroundSegments
    """The segments that 16 masses hit."""
    search_x: Column
    """The x at which the ground is searched, 16 values."""
    g_weights: Weights
    hidden_deltas: Column
    """Gradients before tanh, of a chunk of steps; likewise the next."""
    action_deltas: Column
    chunk_inputs: Column


class OffsetTable:
    """Offsets of the ends of memory blocks: the host computes a table, the kernel reads it. Computing them as
    sums in the kernel is as fast, but LLVM then takes seconds to analyse the addresses."""

    def __init__(self, table: Any = None, first: Any = 0):
        self.table, self.first = table, first
        self.offsets: list[Any] = []

    def add(self, end: Any) -> Any:
        """The next offset: `end`, or what the table says."""
        self.offsets.append(end)
        if self.table is None:
            return end
        return local(OffsetView(self.table, self.first)[len(self.offsets) - 1])


class WorkerMemory(NamedTuple):
    history: StateHistory
    scratch: Scratch


def workspace(
    memory: Memory, first: Any, n: Size, states: Any, ring: Any, table: OffsetTable
) -> WorkerMemory:
    """One worker's memory for a robot with room for so many states."""
    end: Any = 0

    def allocate(count: Any) -> Column:
        nonlocal end
        block = Column(memory, local(first + end))
        end = table.add(end + HIDDEN * blocks(count, HIDDEN))
        return block

    cells, ap = n.cells, n.padded_motors
    history = StateHistory(memory, allocate(states * n.state_values).first, n.state_values, n, ring)
    inputs = allocate(n.input_values)
    w1_transposed, w2_transposed = allocate(HIDDEN * HIDDEN * n.mass_blocks), allocate(ap * HIDDEN)
    activations, g_activations = allocate(FAMILIES * cells), allocate(FAMILIES * cells)
    guard = LANES * n.guard_rows
    stride = local(cells + guard)
    forces = Forces(allocate(FAMILIES * stride) + guard, allocate(FAMILIES * stride) + guard, stride)
    g = Gradient(*(allocate(cells) for _ in range(6)))
    g_inputs, g_sensed = allocate(HIDDEN * n.mass_blocks), allocate(4 * cells)
    g_weights = weights(memory, allocate(HIDDEN * n.weight_rows).first, n)
    hidden_deltas, action_deltas = allocate(CHUNK * HIDDEN), allocate(CHUNK * ap)
    chunk_inputs = allocate(CHUNK * n.input_values)
    below, hit = (
        GroundSegments(*(allocate(count) for _ in GroundSegments._fields)) for count in (cells, LANES)
    )
    scratch = Scratch(
        inputs, w1_transposed, w2_transposed, activations, g_activations, forces, g, g_inputs, g_sensed,
        below, hit, allocate(LANES), g_weights, hidden_deltas, action_deltas, chunk_inputs,
    )  # fmt: skip
    return WorkerMemory(history, scratch)


def workspace_offsets(n: Size, states: int) -> list[int]:
    """End of each block of `workspace`, in order; the last is its size."""
    table = OffsetTable()
    workspace(Memory(), 0, n, states, -1, table)
    return table.offsets

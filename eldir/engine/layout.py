"""Names for what lies in memory: a robot, its states over time, their gradients, and scratch.

All of this is resolved while Taichi compiles: `now.x[i]` is nothing but `lanes[now // 16 + i]`. The same
functions, called with plain numbers, say how much memory a robot needs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from taichi.lang.expr import Expr
from taichi.lang.impl import expr_init, subscript

from eldir.controller import HIDDEN

LANES = 16
"""Masses or springs that are computed at a time."""
CPG_ROWS = 16
"""The ten central pattern generators, padded."""
CHUNK = 50
"""Steps whose weight gradients are summed as one matrix product."""


class Memory(NamedTuple):
    """One array under four views: single values, pairs, 16 and 32 values at a time."""

    values: Any = None
    pairs: Any = None
    lanes: Any = None
    rows: Any = None


class View:
    """`view[i]` is `array[first + i]`."""

    def __init__(self, array: Any, first: Any):
        self.array, self.first = array, first

    def __getitem__(self, i: Any) -> Any:
        return subscript(None, self.array, self.first + i)


class Column(NamedTuple):
    """A quantity from element `first` of a memory on.

    `column[i]` are its values 16 i to 16 i + 15, `column.each[k]` is value k; `pair` and `row` go
    two and 32 values at a time; `column + n` begins n values later.
    """

    memory: Memory
    first: Any

    def __getitem__(self, i: Any) -> Any:
        return View(self.memory.lanes, self.first >> 4)[i]

    @property
    def each(self) -> View:
        return View(self.memory.values, self.first)

    @property
    def pair(self) -> View:
        return View(self.memory.pairs, self.first >> 1)

    @property
    def row(self) -> View:
        return View(self.memory.rows, self.first >> 5)

    def __add__(self, count: Any) -> Column:
        return Column(self.memory, _local(self.first + count))


class Size(NamedTuple):
    """Of one robot, in whole vectors: masses and springs 16, motors 32 at a time."""

    masses: Any
    springs: Any
    motors: Any
    mass_rows: Any
    spring_rows: Any
    motor_blocks: Any

    @property
    def padded_masses(self) -> Any:
        return LANES * self.mass_rows

    @property
    def padded_springs(self) -> Any:
        return LANES * self.spring_rows

    @property
    def padded_motors(self) -> Any:
        return HIDDEN * self.motor_blocks

    @property
    def state_values(self) -> Any:
        return 6 * self.padded_masses + HIDDEN + self.padded_motors + 2 * self.padded_springs

    @property
    def recorded_rows(self) -> Any:
        """Of 16 values, of one state's x, y, vx, vy and activations."""
        return 4 * self.mass_rows + 2 * self.motor_blocks

    @property
    def inputs(self) -> Any:
        return 4 * self.padded_masses + CPG_ROWS

    @property
    def weight_rows(self) -> Any:
        """Of 32 values."""
        return self.inputs + 1 + self.padded_motors + self.motor_blocks


def size(masses: Any, springs: Any, motors: Any) -> Size:
    counts = [_local(n) for n in (masses, springs, motors)]
    rows = [_local(vectors(n, k)) for n, k in zip(counts, (LANES, LANES, HIDDEN), strict=True)]
    return Size(*counts, *rows)


def vectors(count: Any, width: int) -> Any:
    """How many vectors hold `count` values; widths are powers of two, for a shift is fast."""
    return (count + (width - 1)) >> (width.bit_length() - 1)


class Weights(NamedTuple):
    """A controller, or its gradient: a row for every input, then for every output."""

    w1: Column
    b1: Column
    w2: Column
    b2: Column
    all: Column


def weights(memory: Memory, first: Any, n: Size) -> Weights:
    whole = Column(memory, first)
    b1 = Column(memory, _local(first + n.inputs * HIDDEN))
    w2 = b1 + HIDDEN
    return Weights(whole, b1, w2, w2 + n.padded_motors * HIDDEN, whole)


class State(NamedTuple):
    """One instant: the state before a step, and what the step makes of it."""

    x: Column
    y: Column
    vx: Column
    vy: Column
    wx: Column
    """Velocity after the springs, before contact."""
    wy: Column
    hidden: Column
    action: Column
    """Activations of the motors, -1 to 1."""
    dx: Column
    """From a spring's end b to its end a."""
    dy: Column


class History(NamedTuple):
    """The states of one robot, `stride` values apart."""

    memory: Memory
    first: Any
    stride: Any
    n: Size

    def at(self, t: Any) -> State:
        start = Column(self.memory, _local(self.first + t * self.stride))
        masses = [start + c * self.n.padded_masses for c in range(6)]
        hidden = Column(self.memory, _local(start.first + 6 * self.n.padded_masses))
        action = hidden + HIDDEN
        dx = Column(self.memory, _local(action.first + self.n.padded_motors))
        return State(*masses, hidden, action, dx, dx + self.n.padded_springs)


class Gradient(NamedTuple):
    """Of the loss, with respect to one state."""

    x: Column
    y: Column
    vx: Column
    vy: Column
    wx: Column
    wy: Column


class Scratch(NamedTuple):
    """What a worker needs beside the history."""

    inputs: Column
    w1_transposed: Column
    w2_transposed: Column
    fx: Column
    fy: Column
    ends: Column
    """Sums over the springs of every mass, pairs (x, y)."""
    g: Gradient
    g_inputs: Column
    g_weights: Weights
    hidden_deltas: Column
    """Gradients before tanh, of a chunk of steps; likewise the next."""
    action_deltas: Column
    chunk_inputs: Column


class Workspace(NamedTuple):
    history: History
    scratch: Scratch


def workspace(memory: Memory, first: Any, n: Size, steps: Any) -> tuple[Workspace, Any]:
    """One worker's memory for a robot, and where it ends."""
    end = first

    def take(count: Any) -> Column:
        nonlocal end
        piece = Column(memory, end)
        end = _local(end + HIDDEN * vectors(count, HIDDEN))
        return piece

    mp, sp, ap = n.padded_masses, n.padded_springs, n.padded_motors
    history = History(memory, take((steps + 1) * n.state_values).first, n.state_values, n)
    inputs = take(n.inputs)
    transposed = take(4 * mp * HIDDEN), take(ap * HIDDEN)
    forces = take(sp), take(sp), take(2 * mp)
    g = Gradient(*(take(mp) for _ in range(6)))
    g_inputs = take(4 * mp)
    g_weights = weights(memory, take(HIDDEN * n.weight_rows).first, n)
    deltas = take(CHUNK * HIDDEN), take(CHUNK * ap), take(CHUNK * n.inputs)
    scratch = Scratch(inputs, *transposed, *forces, g, g_inputs, g_weights, *deltas)
    return Workspace(history, scratch), end


def workspace_values(n: Size, steps: int) -> int:
    """How many values `workspace` takes."""
    return int(workspace(Memory(), 0, n, steps)[1])


def _local(value: Any) -> Any:
    """Computed once, where it stands; a plain number is what it is."""
    return expr_init(value) if isinstance(value, Expr) else value

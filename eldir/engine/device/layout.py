"""Where a robot's numbers lie on a device, and names for them.

A robot's weights, springs and start lie as on the CPU (`eldir.engine.pack`). Its history is what the reverse
sweep and the weights' gradient need of each step, side by side.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from eldir.controller import HIDDEN
from eldir.engine.device.block import SharedMemory, Values
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels.layout import CPG_ROWS, Footing, Forces, Gradient, blocks
from eldir.engine.kernels.memory import local

PARTS = 8
"""Partial sums of what the threads of a block add up."""
ROWS = 8
"""Rows of weights that a thread loads before it multiplies them."""
WARP = 32
"""Threads that run in step."""
STATE = 4
"""x, y, vx, vy."""
CARRY = 6
"""Values of a mass that one launch leaves to the next: its state, or the gradients of it, and the two
velocities of the adjacent step."""


class Place(NamedTuple):
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
    def kept_inputs(self) -> Any:
        """The inputs and, padded to eight, a 1, whose weight is the hidden units' bias."""
        return self.inputs + 8

    @property
    def step_values(self) -> Any:
        """Values of the history for one step."""
        return STATE * self.cell_rows + 2 * HIDDEN + self.padded_motors + self.kept_inputs


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
    """`Size.kept_inputs` values."""


def step_history(history: Any, place: Place, n: Size, t: Any) -> StepHistory:
    start = Values(history, local(place.history_at + t * n.step_values))
    x, y, wx, wy = (start + c * n.cell_rows for c in range(4))
    hidden = start + 4 * n.cell_rows
    action = hidden + 2 * HIDDEN
    return StepHistory(x, y, wx, wy, hidden, hidden + HIDDEN, action, action + n.padded_motors)


class Shared(NamedTuple):
    """What the threads of a robot share."""

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
    under: Any
    """The segment of ground that was last found below each mass."""
    facing: Any
    """The segment that each mass hits."""
    asked: Any
    """The x at which the ground is searched."""

    def of(self, thread: Any) -> Shared:
        """The same with what one thread looks up of the ground."""
        facing = Footing(*(column + thread for column in self.facing))
        return self._replace(facing=facing, asked=self.asked + thread)

    @property
    def carry(self) -> tuple[Values, ...]:
        """What one launch of the forward pass leaves to the next, in the order of `DeviceLaunch.carry`."""
        return self.x, self.y, self.vx, self.vy, *self._adjacent

    @property
    def g_carry(self) -> tuple[Values, ...]:
        """The same for the reverse sweep."""
        return self.g.x, self.g.y, self.g.vx, self.g.vy, *self._adjacent

    @property
    def _adjacent(self) -> tuple[Values, ...]:
        return () if self.adjacent_vx is None else (self.adjacent_vx, self.adjacent_vy)

    @property
    def g_activations(self) -> Values:
        """Each spring's activation gives way to its gradient."""
        return self.activations


def forward_memory(memory: SharedMemory, threads: int, friction: bool, staggered: bool) -> Shared:
    """Shared memory of a robot's forward pass."""
    x, forces = memory.take(STATE * threads), memory.take(2 * FAMILIES * threads)
    activations, inputs = memory.take(FAMILIES * threads), memory.take(CPG_ROWS + 4 * threads + 8)
    partial, sums, hidden = memory.take(threads), memory.take(2 * PARTS), memory.take(HIDDEN)
    return Shared(
        x, x + threads, x + 2 * threads, x + 3 * threads,
        Forces(forces, forces + FAMILIES * threads, threads), activations, None, inputs, None, partial, sums,
        hidden, None, *_adjacent(memory, threads, staggered), *_ground(memory, threads, friction),
    )  # fmt: skip


def reverse_memory(memory: SharedMemory, threads: int, friction: bool, staggered: bool) -> Shared:
    """Shared memory of a robot's reverse sweep. Where the springs no longer need a step's positions and the
    gradients of its velocities, the motors' deltas lie; where their forces were, what was sensed."""
    x, forces = memory.take(8 * threads), memory.take(2 * FAMILIES * threads)
    activations = memory.take(FAMILIES * threads)
    partial, sums, hidden = memory.take(threads), memory.take(2 * PARTS), memory.take(2 * HIDDEN)
    return Shared(
        x, x + threads, None, None, Forces(forces, forces + FAMILIES * threads, threads), activations,
        Gradient(*(x + k * threads for k in range(2, 8))), x, forces, partial, sums,  # type: ignore[arg-type]
        hidden, hidden + HIDDEN, *_adjacent(memory, threads, staggered), *_ground(memory, threads, friction),
    )  # fmt: skip


def _adjacent(memory: SharedMemory, threads: int, staggered: bool) -> tuple[Any, Any]:
    if not staggered:
        return None, None
    x = memory.take(2 * threads)
    return x, x + threads


def _ground(memory: SharedMemory, threads: int, friction: bool) -> tuple[Any, Any, Any]:
    """What masses remember of the ground, and look up; nothing without friction."""
    if not friction:
        return None, None, None
    fields = len(Footing._fields)
    columns = memory.take((2 * fields + 1) * threads)
    under = Footing(*(columns + k * threads for k in range(fields)))  # type: ignore[arg-type]
    facing = Footing(*(columns + (fields + k) * threads for k in range(fields)))  # type: ignore[arg-type]
    return under, facing, columns + 2 * fields * threads

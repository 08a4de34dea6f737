"""The four kernels of a device: transposed weights, forward pass, reverse sweep, gradient and update.

Four launches and not one: what one writes the next can read, each needs fewer registers, and a pass may be
cut anywhere in time.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from eldir.engine.compiler import ti
from eldir.engine.device import layout
from eldir.engine.device.forward import forward
from eldir.engine.device.layout import SharedMemory, Values
from eldir.engine.device.records import ASCENDING, DeviceLaunch
from eldir.engine.device.reverse import reverse
from eldir.engine.device.update import transpose, update
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels.contact import FRICTION
from eldir.engine.kernels.layout import SCALARS, State, read_row
from eldir.engine.kernels.learning_launch import Robot, constants
from eldir.engine.kernels.memory import reread
from eldir.engine.kernels.simd import Simd, tanh_of
from eldir.engine.runtime import argument_types, make_kernel
from eldir.engine.validity import OK

Kernel = Callable[[DeviceLaunch], None]


class Block(NamedTuple):
    """One robot's part of a launch, which a block of threads computes, at one step."""

    launch: DeviceLaunch
    threads: int
    phase: Any
    """See `phase_of`."""
    at: layout.DeviceOffsets
    robot: Robot
    weights: Values
    best: Values
    transposed: Values
    g_weights: Values
    carry: Values
    shared: layout.Shared
    t: Any = None
    history: layout.StepHistory | None = None
    now: State | None = None
    before: State | None = None
    """The same as the history holds it: a phase may replace positions in shared memory."""

    def at_step(self, t: Any) -> "Block":
        history = layout.step_history(self.launch.history, self.at, self.robot.n, t)
        m = self.shared
        now = State(m.x, m.y, m.vx, m.vy, history.wx, history.wy, None, None, None)  # type: ignore[arg-type]
        before = State(history.x, history.y, None, None, history.wx, history.wy, m.partial, None, None)  # type: ignore[arg-type]
        return self._replace(t=t, history=history, now=now, before=before)


class Kernels(NamedTuple):
    transpose: Kernel
    forward: Kernel
    reverse: Kernel
    update: Kernel


@cache
def kernels(precision: str, threads: int, on_device: bool = True) -> Kernels:
    """The kernels for robots of at most so many cells, for a device or for the CPU (`phase_of`)."""
    simd = scalars(precision, threads)
    phase = phase_of(on_device, threads)
    types = argument_types(simd.real)
    values = shared_values(threads)

    def kernel(
        run: Any, memory: Callable[[SharedMemory, int, bool, bool], layout.Shared], min_motors: int = 0
    ) -> Kernel:
        @ti.func
        def work(thread, launch: ti.template()):
            worker, own = thread, 0
            if ti.static(on_device):
                worker, own = thread // threads, thread % threads
            at = ti.static(read_row(launch.offsets, launch.first + worker, layout.DeviceOffsets))
            if launch.status[at.robot] == OK and at.motors >= min_motors:
                shared = ti.static(
                    memory(
                        SharedMemory(simd.real, on_device, launch.shared, worker * values),
                        threads,
                        launch.settings.contact == FRICTION,
                        launch.settings.staggered,
                    )
                )
                inverse_count = ti.cast(1, simd.real) / at.masses
                decay = launch.arrays.scalars[SCALARS * at.robot]
                gravity_dt = launch.arrays.scalars[SCALARS * at.robot + 1]
                friction = launch.arrays.scalars[SCALARS * at.robot + 2]
                # The greatest speed is read where it is used: a register for the whole pass would make
                # others spill.
                scalars_of_robot = ti.static(
                    (decay, gravity_dt, friction, reread(launch.arrays.scalars, SCALARS * at.robot + 3))
                )
                robot = ti.static(_robot(simd, launch, at, scalars_of_robot, inverse_count))
                run(own, ti.static(_block(launch, threads, phase, at, robot, shared)))

        return make_kernel(DeviceLaunch, types, work, threads if on_device else 1)

    return Kernels(
        kernel(transpose, layout.forward_memory), kernel(forward, layout.forward_memory),
        kernel(reverse, layout.reverse_memory, 1), kernel(update, layout.forward_memory, 1),
    )  # fmt: skip


def phase_of(on_device: bool, threads: int) -> Any:
    """The function `phase(work, own, block)`: every thread of a block does `work(thread, block)`, and waits
    at a barrier for the others. `own` is the number of the thread that calls it.

    On a device the threads run at once. On the CPU the same source is a loop over the threads, ascending or
    descending as the launch says, and shared memory is a part of an array: where the two orders disagree, a
    barrier is missing."""

    @ti.func
    def phase(work: ti.template(), own, block: ti.template()):
        if ti.static(on_device):
            work(own, block)
            ti.simt.block.sync()
        else:
            for k in range(threads):
                work(k if block.launch.order == ASCENDING else threads - 1 - k, block)

    return phase


def shared_values(threads: int) -> int:
    """Most values that the threads of a robot share in one kernel."""
    used = []
    for memory in (layout.forward_memory, layout.reverse_memory):
        counted = SharedMemory()
        memory(counted, threads, True, True)
        used.append(counted.used)
    return max(used)


def scalars(precision: str, threads: int) -> Simd:
    """What `vectors` is for 16 values at a time, for single ones: the same formulas compute with both."""
    real = ti.f32 if precision == "f32" else ti.f64

    @ti.func
    def lanes(value):
        return ti.cast(value, real)

    @ti.func
    def shifted(column: ti.template(), i, count):
        """The value `count` cells further on, 0 beyond the first and the last."""
        k = i + count
        inside = k >= 0 and k < threads
        return ti.select(inside, column[ti.max(ti.min(k, threads - 1), 0)], ti.cast(0, real))

    @ti.func
    def any_positive(mark):
        return mark > 0

    return Simd(real, 1, lanes, None, shifted, any_positive, tanh_of(real))


def _robot(
    simd: Simd, launch: DeviceLaunch, at: layout.DeviceOffsets, scalars: tuple[Any, Any, Any, Any],
    inverse_count: Any,
) -> Robot:  # fmt: skip
    n = layout.size(at.masses, at.motors, at.cells, at.reach)
    own, cell_at = launch.arrays, at.cell_at
    return Robot(
        simd, n, **constants(launch, *scalars), inverse_count=inverse_count,
        start=Values(own.start, 2 * cell_at), reference=Values(own.reference, 2 * cell_at),
        velocity=Values(own.velocity, 2 * cell_at),
        mask=Values(own.mask, cell_at), cell=Values(own.cell, at.mass_at),
        motor=Values(own.motor, at.motor_at), rest_length=Values(own.rest_length, FAMILIES * cell_at),
        stiffness_dt=Values(own.stiffness_dt, FAMILIES * cell_at),
    )  # fmt: skip


def _block(
    launch: DeviceLaunch, threads: int, phase: Any, at: layout.DeviceOffsets, robot: Robot,
    shared: layout.Shared,
) -> Block:  # fmt: skip
    by_weight = launch.weights, launch.best, launch.transposed, launch.g_weights
    return Block(
        launch, threads, phase, at, robot, *(Values(a, at.weight_at) for a in by_weight),
        Values(launch.carry, layout.CARRY * at.cell_at), shared,
    )  # fmt: skip

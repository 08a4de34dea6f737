"""The four kernels of a device: transposed weights, forward pass, reverse sweep, gradient and update.

Four launches and not one: what one writes the next can read, each needs fewer registers, and a pass may be
cut anywhere in time.
"""

from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

from eldir.engine.compiler import ti
from eldir.engine.device import forward, layout, reverse, update
from eldir.engine.device.block import SharedMemory, Values, phase_of
from eldir.engine.device.records import DeviceLaunch
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels import contact, masses, springs
from eldir.engine.kernels.layout import OWN, State, place
from eldir.engine.kernels.views import GroundView, Law, RobotView, ground_of, law_of
from eldir.engine.launch import argument_types, kernel_of

Kernel = Callable[[DeviceLaunch], None]


class Block(NamedTuple):
    """One robot's part of a launch, at one step."""

    launch: DeviceLaunch
    place: layout.Place
    n: layout.Size
    body: RobotView
    law: Law
    ground: GroundView
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


class Kernels(NamedTuple):
    transpose: Kernel
    forward: Kernel
    reverse: Kernel
    update: Kernel


@cache
def kernels(precision: str, threads: int, on_device: bool = True) -> Kernels:
    """The kernels for robots of at most so many cells, for a device or for the CPU (`block`)."""
    kind = scalars(precision, threads)
    phase = phase_of(on_device, threads)
    spring = springs.functions(kind)
    touch = contact.functions(kind)
    mass = masses.functions(kind, touch, spring)
    ahead = forward.functions(kind, threads, phase, spring, mass, touch)
    back = reverse.functions(kind, threads, phase, spring, mass, touch, ahead)
    learn = update.functions(kind, threads, phase, ahead)
    types = argument_types(kind.real)
    values = shared_values(threads)

    def kernel(
        run: Any, memory: Callable[[SharedMemory, int, bool, bool], layout.Shared], min_motors: int = 0
    ) -> Kernel:
        @ti.func
        def work(thread, launch: ti.template()):
            worker, own = thread, 0
            if ti.static(on_device):
                worker, own = thread // threads, thread % threads
            at = ti.static(place(launch.places, launch.first + worker, layout.Place))
            if launch.status[at.robot] < 0 and at.motors >= min_motors:
                shared = ti.static(
                    memory(
                        SharedMemory(kind.real, on_device, launch.shared, worker * values),
                        threads,
                        launch.settings.contact == contact.FRICTION,
                        launch.settings.staggered,
                    )
                )
                per_mass = ti.cast(1, kind.real) / at.masses
                decay = launch.arrays.own[OWN * at.robot]
                gravity_dt = launch.arrays.own[OWN * at.robot + 1]
                friction = launch.arrays.own[OWN * at.robot + 2]
                law = ti.static(law_of(launch, decay, gravity_dt, friction))
                run(own, ti.static(_block(launch, at, law, per_mass, shared)), ti.static(_at))

        return kernel_of(DeviceLaunch, types, work, threads if on_device else 1)

    return Kernels(
        kernel(learn.transpose, layout.forward_memory), kernel(ahead.forward, layout.forward_memory),
        kernel(back.reverse, layout.reverse_memory, 1), kernel(learn.update, layout.forward_memory, 1),
    )  # fmt: skip


def shared_values(threads: int) -> int:
    """Most values that the threads of a robot share in one kernel."""
    used = []
    for memory in (layout.forward_memory, layout.reverse_memory):
        counted = SharedMemory()
        memory(counted, threads, True, True)
        used.append(counted.used)
    return max(used)


def scalars(precision: str, threads: int) -> SimpleNamespace:
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
    def any(mark):
        return mark > 0

    return SimpleNamespace(real=real, width=1, lanes=lanes, shifted=shifted, any=any)


def _block(
    launch: DeviceLaunch, place: layout.Place, law: Law, per_mass: Any, shared: layout.Shared
) -> Block:
    n = layout.size(place.masses, place.motors, place.cells, place.reach)
    own = launch.arrays
    cell_at = place.cell_at
    body = RobotView(
        n, per_mass, Values(own.start, 2 * cell_at), Values(own.reference, 2 * cell_at),
        Values(own.velocity, 2 * cell_at), Values(own.mask, cell_at), Values(own.cell, place.mass_at),
        Values(own.motor, place.motor_at), Values(own.rest_length, FAMILIES * cell_at),
        Values(own.stiffness_dt, FAMILIES * cell_at), launch.cpgs,
    )  # fmt: skip
    by_weight = launch.weights, launch.best, launch.transposed, launch.g_weights
    return Block(
        launch, place, n, body, law, ground_of(launch), *(Values(a, place.weight_at) for a in by_weight),
        Values(launch.carry, layout.CARRY * cell_at), shared,
    )  # fmt: skip


def _at(block: Block, t: Any) -> Block:
    """The block at step t."""
    history = layout.step_history(block.launch.history, block.place, block.n, t)
    m = block.shared
    now = State(m.x, m.y, m.vx, m.vy, history.wx, history.wy, None, None, None)  # type: ignore[arg-type]
    before = State(history.x, history.y, None, None, history.wx, history.wy, m.partial, None, None)  # type: ignore[arg-type]
    return block._replace(t=t, history=history, now=now, before=before)

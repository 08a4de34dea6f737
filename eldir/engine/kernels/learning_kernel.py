"""The kernel: a queue of robots over workers, each robot simulated, differentiated and taught in one go.

Everything a worker touches lies in its own workspace, so results depend neither on the number of
threads nor on which robots are in the queue. Whether to go backward or to record is asked once a robot and
not compiled in: one code for all means that a rollout shows, to the last bit, what was learned.
"""

from functools import cache
from typing import Any, NamedTuple

from eldir.engine.compiler import ti
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels import contact, controller, layout, masses, springs
from eldir.engine.kernels.layout import CHUNK, OWN
from eldir.engine.kernels.memory import Column, Memory
from eldir.engine.kernels.vectors import vectors


class Law(NamedTuple):
    """Scalars of a scene."""

    dt: Any
    decay: Any
    """Of this robot's velocities in one step."""
    gravity_dt: Any
    """This robot's."""
    friction: Any
    """This robot's, where the ground lets slip."""
    actuation: Any
    sense: Any
    """Scale of what is sensed."""
    softening: Any
    """Added to a length before dividing [m]."""
    resting: Any
    """A mass that falls more slowly does not land [m/s]."""
    tiny: Any
    listening: Any
    """Whether the controller senses."""
    controlling: Any
    """Whether it acts in bodies without motors."""
    stopping: Any
    """Whether nothing follows when a robot has blown up."""
    staggered: Any
    """Known while compiling: positions are half a step ahead of velocities (docs/reference/accuracy.md)."""
    physical: Any
    """Known while compiling: whether the gradient with respect to physics is wanted."""


class Learning(NamedTuple):
    """Of the update."""

    length: Any
    bias_gain: Any
    """How many gradients move the hidden bias."""
    least_gradient: Any


class Ground(NamedTuple):
    contact: Any
    """Known while compiling: NO_CONTACT, NO_SLIP or FRICTION."""
    level: Any
    top: Any
    """Nothing of it is higher."""
    segments: Any
    grid_from: Any
    cells_per_m: Any
    cells: Any
    cell_segment: Any
    last: Any
    """Segment."""


class Pull(NamedTuple):
    """What takes the loss's place where `on`: the gradient of something with respect to all positions."""

    on: Any
    positions: Column
    """Of every state x, then y."""


class Body(NamedTuple):
    """One robot."""

    n: layout.Size
    per_mass: Any
    """1/M."""
    start: Column
    """x, then y."""
    reference: Column
    """What sensed displacements are relative to; x, then y."""
    velocity: Column
    """In the beginning; x, then y."""
    mask: Column
    """1 for a cell with a mass, else 0."""
    cell: Column
    """Of each mass."""
    motor: Column
    """Where the spring of each motor stands among all springs."""
    rest_length: Column
    stiffness_dt: Column
    """0 where there is no spring."""
    cpgs: Any


def body_of(n: layout.Size, per_mass: Any, cell_at: Any, mass_at: Any, motor_at: Any, arrays: tuple) -> Body:
    start, reference, velocity, mask1, mask, cell, motor, rest_length, stiffness_dt, cpgs = arrays
    return Body(
        n, per_mass,
        Column(Memory(lanes=start), 2 * cell_at), Column(Memory(lanes=reference), 2 * cell_at),
        Column(Memory(lanes=velocity), 2 * cell_at),
        Column(Memory(values=mask1, lanes=mask), cell_at),
        Column(Memory(values=cell), mass_at), Column(Memory(values=motor), motor_at),
        Column(Memory(lanes=rest_length), FAMILIES * cell_at),
        Column(Memory(lanes=stiffness_dt), FAMILIES * cell_at), cpgs,
    )  # fmt: skip


@cache
def build(precision: str) -> Any:
    """The kernel for 'f32' or 'f64'."""
    kind = vectors(precision)
    real, lanes, row = kind.real, kind.lanes, kind.row
    spring, brain = springs.functions(kind), controller.functions(kind)
    touch = contact.functions(kind)
    mass = masses.functions(kind, touch, spring)
    scalars, ints = ti.types.ndarray(dtype=real, ndim=1), ti.types.ndarray(dtype=ti.i32, ndim=1)
    by_2, by_4, by_16, by_32 = (ti.types.ndarray(dtype=v, ndim=1) for v in (kind.pair, kind.quad, lanes, row))

    @ti.func
    def rollout(
        history: ti.template(), body: ti.template(), law: ti.template(), ground: ti.template(),
        weights: ti.template(), work: ti.template(), steps,
    ):  # fmt: skip
        """All steps; returns the one at which the robot blew up, or -1."""
        first = ti.static(history.at(0))
        for i in range(body.n.cell_rows):
            x, y = body.start[i], body.start[body.n.cell_rows + i]
            vx, vy = body.velocity[i], body.velocity[body.n.cell_rows + i]
            if ti.static(law.staggered):
                x, y = x + 0.5 * law.dt * vx, y + 0.5 * law.dt * vy
            first.x[i], first.y[i] = x, y
            first.vx[i], first.vy[i] = vx, vy
        if ti.static(ground.contact == contact.FRICTION):
            touch.forget(work.under, body)
        blown = -1
        for t in range(steps):
            now = ti.static(history.at(t))
            after = ti.static(history.at(t + 1))
            if body.n.motors > 0 or law.controlling:
                brain.act(now, ti.static(history.at(ti.max(t - 1, 0))), body, law, weights, t, work)
            spring.push(now, body, law, work)
            fastest = mass.advance(now, after, body, law, ground, work)
            if blown < 0 and not (fastest.sum() < 1e6):
                blown = t
                if law.stopping:
                    break
        return blown

    @ti.func
    def loss_of(history: ti.template(), body: ti.template(), law: ti.template(), steps):
        """Minus the mean forward displacement."""
        last, before = ti.static(history.at(steps), history.at(steps - 1))
        forward = lanes(0.0)
        for i in range(body.n.cell_rows):
            forward += last.x[i] - body.start[i]
            if ti.static(law.staggered):
                forward += 0.5 * (before.x[i] - last.x[i])
        return -forward.sum() * body.per_mass

    @ti.func
    def seed(g: ti.template(), body: ti.template(), share):
        """The gradient of the loss with respect to the state in which a window ends."""
        for i in range(body.n.cell_rows):
            g.x[i] = share * body.mask[i]
            g.y[i], g.vx[i], g.vy[i] = lanes(0.0), lanes(0.0), lanes(0.0)

    @ti.func
    def tug(g: ti.template(), body: ti.template(), pull: ti.template(), t):
        """Adds to the gradient with respect to positions what is wanted of state t."""
        if pull.on:
            rows = body.n.cell_rows
            for i in range(rows):
                g.x[i] = g.x[i] + pull.positions[2 * rows * t + i]
                g.y[i] = g.y[i] + pull.positions[2 * rows * t + rows + i]

    @ti.func
    def reverse(
        history: ti.template(), body: ti.template(), law: ti.template(), ground: ti.template(),
        weights: ti.template(), work: ti.template(), slopes: ti.template(), pull: ti.template(),
        steps, window,
    ):  # fmt: skip
        """The gradient of the loss with respect to the weights, into `work.g_weights`; with a window, of the
        displacements in all windows, each traced back to its own beginning and no further. And, where asked,
        with respect to physics, into `slopes`."""
        g = ti.static(work.g)
        acting = body.n.motors > 0 or law.controlling
        for i in range(body.n.weight_rows):
            work.g_weights.all.row[i] = row(0.0)
        share = -body.per_mass * (0.5 if ti.static(law.staggered) else 1.0)
        if ti.static(law.physical):
            kind.fill(slopes.stiffness_dt, body.n.slope_values >> 4, 0.0)
            share *= ti.select(pull.on, 0.0, 1.0)
        seed(g, body, share)
        brain.begin_adjoint(body, work)
        kept = 0
        for back in range(steps):
            t = steps - 1 - back
            if back > 0 and (t + 1) % window == 0:
                seed(g, body, share)
            if ti.static(law.physical):
                tug(g, body, pull, t + 1)
            now = ti.static(history.at(t))
            mass.advance_adjoint(now, body, law, ground, work, slopes)
            delta = ti.static(work.action_deltas + kept * body.n.padded_motors)
            spring.push_adjoint(now, body, law, work, slopes, delta)
            if acting:
                earlier = ti.static(history.at(ti.max(t - 1, 0)))
                brain.act_adjoint(now, earlier, body, law, weights, t, work, kept)
            if ti.static(law.staggered):
                if back == 0:
                    for i in range(body.n.cell_rows):
                        g.x[i] = g.x[i] + share * body.mask[i]
            kept += 1
            if kept == CHUNK or t == 0:
                if acting:
                    latest = ti.static(history.at(t + kept - 1))
                    brain.add_chunk(latest, history.stride, body, law, work, kept)
                kept = 0
        if ti.static(law.physical):
            tug(g, body, pull, 0)
            for i in range(body.n.cell_rows):
                gx, gy = g.vx[i], g.vy[i]
                if ti.static(law.staggered):  # positions are half a step ahead
                    gx, gy = gx + 0.5 * law.dt * g.x[i], gy + 0.5 * law.dt * g.y[i]
                slopes.velocity[i], slopes.velocity[body.n.cell_rows + i] = gx, gy

    @ti.func
    def update(weights: ti.template(), g: ti.template(), rows, learning: ti.template()):
        """Against the gradient, always by the same length (paper, Sect. Learning)."""
        square = row(0.0)
        for i in range(rows):
            square += g.all.row[i] * g.all.row[i]
        bias = g.b1.row[0]
        square += (learning.bias_gain - 1.0) * bias * bias
        step = learning.length / (ti.sqrt(square.sum()) + learning.least_gradient)
        for i in range(rows):
            weights.all.row[i] = weights.all.row[i] - step * g.all.row[i]
        weights.b1.row[0] = weights.b1.row[0] - (learning.bias_gain - 1.0) * step * bias

    @ti.kernel
    def run(
        robots: ti.i32, workers: ti.i32, steps: ti.i32, window: ti.i32, iterations: ti.i32, workspace: ti.i32,
        backward: ti.i32, recording: ti.i32, CONTACT: ti.template(), STAGGERED: ti.template(),
        PHYSICAL: ti.template(), pulling: ti.i32,
        states: ti.i32, ring: ti.i32, listening: ti.i32, controlling: ti.i32, stopping: ti.i32,
        dt: real, actuation: real, sense: real,
        softening: real, resting: real, tiny: real, length: real, bias_gain: real, least_gradient: real,
        level: real, top: real, grid_from: real, cells_per_m: real,
        segments: scalars, cell_segment: ints, last_segment: ti.i32, cpgs: by_16,
        queue: ints, places: ints, ends: ints, pieces: ti.i32,
        own: scalars, start: by_16, reference: by_16, velocity: by_16,
        mask1: scalars, mask: by_16, cell: ints, motor: ints, rest_length: by_16, stiffness_dt: by_16,
        weights1: scalars, weights16: by_16, weights32: by_32, best: by_32,
        work1: scalars, work2: by_2, work4: by_4, work16: by_16, work32: by_32,
        losses: scalars, status: ints, record: by_16,
        slopes1: scalars, slopes16: by_16, pulls: by_16,
    ):  # fmt: skip
        ti.loop_config(block_dim=1)
        for worker in range(workers):
            learning = ti.static(Learning(length, bias_gain, least_gradient))
            ground = ti.static(
                Ground(
                    CONTACT, level, top, segments, grid_from, cells_per_m,
                    cell_segment.shape[0], cell_segment, last_segment,
                )
            )  # fmt: skip
            while True:
                r = ti.atomic_add(queue[0], 1)
                if r >= robots:
                    break
                decay, gravity_dt, friction = own[OWN * r], own[OWN * r + 1], own[OWN * r + 2]
                law = ti.static(
                    Law(
                        dt, decay, gravity_dt, friction, actuation, sense, softening, resting, tiny,
                        listening, controlling, stopping, STAGGERED, PHYSICAL,
                    )
                )  # fmt: skip
                at = ti.static(layout.place(places, r))
                n = ti.static(layout.size(at.masses, at.motors, at.cells, at.reach))
                per_mass = ti.cast(1, real) / n.masses
                arrays = ti.static(
                    (start, reference, velocity, mask1, mask, cell, motor, rest_length, stiffness_dt, cpgs)
                )
                body = ti.static(body_of(n, per_mass, at.cell_at, at.mass_at, at.motor_at, arrays))
                memory = ti.static(Memory(work1, work2, work4, work16, work32))
                mine = ti.static(
                    layout.workspace(
                        memory, worker * workspace, n, states, ring, layout.Ends(ends, r * pieces)
                    )
                )  # fmt: skip
                taught = ti.static(Memory(values=weights1, lanes=weights16, rows=weights32))
                weights = ti.static(layout.weights(taught, at.weight_at, n))
                slopes = ti.static(layout.slopes(Memory(slopes1, lanes=slopes16), at.slopes_at, n))
                pull = ti.static(Pull(pulling, Column(Memory(lanes=pulls), at.pulls_at)))
                rows = n.weight_rows
                acting = n.motors > 0 or controlling
                least = ti.cast(0, real)
                blown = -1
                spring.prepare(body, mine.scratch)
                for i in range(iterations + 1):
                    if acting:
                        brain.prepare(body, law, weights, mine.scratch)
                    blown = rollout(mine.history, body, law, ground, weights, mine.scratch, steps)
                    if blown >= 0:
                        break
                    loss = loss_of(mine.history, body, law, steps)
                    losses[r * (iterations + 1) + i] = loss
                    if backward:
                        if iterations > 0 and (i == 0 or loss < least):
                            least = loss
                            for k in range(rows):
                                best[(at.weight_at >> 5) + k] = weights.all.row[k]
                        if (acting or ti.static(PHYSICAL)) and (i < iterations or iterations == 0):
                            reverse(
                                mine.history, body, law, ground, weights, mine.scratch, slopes, pull,
                                steps, window,
                            )  # fmt: skip
                            if iterations > 0:
                                update(weights, mine.scratch.g_weights, rows, learning)
                            else:  # the gradient is what was asked for
                                for k in range(rows):
                                    best[(at.weight_at >> 5) + k] = mine.scratch.g_weights.all.row[k]
                status[r] = blown
                if recording:
                    # As it lies: x, y, vx, vy and the activations of every state.
                    for t in range(steps + 1):
                        state = ti.static(mine.history.at(t))
                        q = at.record_at + t * n.recorded_rows
                        for k in range(4 * n.cell_rows):
                            record[q + k] = state.x[k]
                        for k in range(2 * n.motor_blocks):
                            record[q + 4 * n.cell_rows + k] = state.action[k]

    return run

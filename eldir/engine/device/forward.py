"""The forward pass of one robot in phases: what `rollout` and `controller` of the CPU's kernels do."""

from types import SimpleNamespace

from eldir.controller import HIDDEN
from eldir.engine.compiler import ti
from eldir.engine.device.layout import PARTS, ROWS, WARP
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels.contact import FRICTION
from eldir.engine.kernels.layout import CPG_ROWS
from eldir.engine.kernels.tanh import tanh_of

FASTEST = 1e6 / 16
"""A robot with a faster mass has blown up [m/s]. The CPU adds the greatest speeds of 16 groups of masses: a
device is never the last to notice."""


def functions(
    kind: SimpleNamespace,
    threads: int,
    phase: object,
    spring: SimpleNamespace,
    mass: SimpleNamespace,
    touch: SimpleNamespace,
) -> SimpleNamespace:
    real, tanh = kind.real, tanh_of(kind.real)
    groups = threads // WARP

    @ti.func
    def cell_of(thread, b: ti.template()):
        """The cell that a thread computes: threads beyond the grid repeat its last cell, which is empty.

        With a condition instead, the compilers lead the threads beyond past the next phase, to a copy of the
        barrier of their own. Threads of one warp must meet at the same one."""
        return ti.min(thread, b.n.cell_rows - 1)

    @ti.func
    def rounds(count, first, step: ti.template()):
        """How many of `first`, `first` + `step`, ... are less than `count`."""
        return (count - first + step - 1) // step

    @ti.func
    def sum_parts(thread, values: ti.template(), sums: ti.template(), arrays: ti.template()):
        """Partial sums of arrays of `threads` values that lie one after the other."""
        if thread < arrays * PARTS:
            first = thread // PARTS * threads + thread % PARTS
            s = ti.cast(0, real)
            for k in ti.static(range(threads // PARTS)):
                s += values[first + PARTS * k]
            sums[thread] = s

    @ti.func
    def total(sums: ti.template(), array: ti.template()):
        s = ti.cast(0, real)
        for k in ti.static(range(PARTS)):
            s += sums[PARTS * array + k]
        return s

    @ti.func
    def begin(thread, b: ti.template()):
        m, n = ti.static(b.shared, b.n)
        zero = ti.cast(0, real)
        for k, column in ti.static(enumerate(m.carry)):
            column[thread] = zero
            if b.launch.settings.first > 0 and thread < n.cell_rows:
                column[thread] = b.carry[k * n.cell_rows + thread]
        if b.launch.settings.first == 0 and thread < n.cell_rows:
            x, y = b.body.start[thread], b.body.start[n.cell_rows + thread]
            vx, vy = b.body.velocity[thread], b.body.velocity[n.cell_rows + thread]
            if ti.static(b.law.staggered):  # positions are half a step ahead
                x, y = x + 0.5 * b.law.dt * vx, y + 0.5 * b.law.dt * vy
                m.adjacent_vx[thread], m.adjacent_vy[thread] = vx, vy
            m.x[thread], m.y[thread], m.vx[thread], m.vy[thread] = x, y, vx, vy
        if ti.static(b.ground.contact == FRICTION):
            touch.forget(m.under, b.body, cell_of(thread, b))
        for f in ti.static(range(FAMILIES)):
            m.activations[f * threads + thread] = zero
            m.forces.x[f * threads + thread], m.forces.y[f * threads + thread] = zero, zero
        for k in range(rounds(n.kept_inputs, thread, threads)):
            row = thread + k * threads
            m.inputs[row] = ti.select(row == n.inputs, ti.cast(1, real), zero)

    @ti.func
    def sum_positions(thread, b: ti.template()):
        sum_parts(thread, b.shared.x, b.shared.sums, 2)

    @ti.func
    def sense(thread, b: ti.template()):
        """The pattern generators; displacement of every mass from the centre of mass, and velocity."""
        m, n, law, body = ti.static(b.shared, b.n, b.law, b.body)
        if thread < CPG_ROWS:
            m.inputs[thread] = body.cpgs[CPG_ROWS * b.t + thread]
        if law.listening:
            cx, cy = total(m.sums, 0) * body.per_mass, total(m.sums, 1) * body.per_mass
            if thread < n.masses:
                k, row = body.cell[thread], CPG_ROWS + 4 * thread
                m.inputs[row] = (m.x[k] - cx - body.reference[k]) * law.sense
                m.inputs[row + 1] = (m.y[k] - cy - body.reference[n.cell_rows + k]) * law.sense
                vx, vy = m.vx[k], m.vy[k]
                if ti.static(law.staggered):  # half a step later, as positions are
                    vx += 0.5 * (vx - m.adjacent_vx[k])
                    vy += 0.5 * (vy - m.adjacent_vy[k])
                m.inputs[row + 2], m.inputs[row + 3] = vx * law.sense, vy * law.sense

    @ti.func
    def add_inputs(thread, b: ti.template()):
        """W1 u: each group of 32 threads takes every so many eight inputs, each thread a hidden unit."""
        m, n = ti.static(b.shared, b.n)
        group, unit = thread // WARP, thread % WARP
        s = ti.cast(0, real)
        for k in range(rounds(n.inputs // ROWS, group, groups)):
            row = ROWS * (group + k * groups)
            for i in ti.static(range(ROWS)):
                s += b.weights[HIDDEN * (row + i) + unit] * m.inputs[row + i]
        m.partial[thread] = s
        for k in range(rounds(n.kept_inputs, thread, threads)):
            b.history.inputs[thread + k * threads] = m.inputs[thread + k * threads]

    @ti.func
    def activate(thread, b: ti.template()):
        """h = tanh(W1 u + b1)"""
        m = ti.static(b.shared)
        if thread < HIDDEN:
            s = b.weights[b.n.bias + thread]
            for group in ti.static(range(groups)):
                s += m.partial[WARP * group + thread]
            h = tanh(s)
            m.hidden[thread] = h
            b.history.hidden[thread] = h

    @ti.func
    def act(thread, b: ti.template()):
        """a = tanh(W2 h + b2), a thread each motor."""
        m, n = ti.static(b.shared, b.n)
        for k in range(rounds(n.padded_motors, thread, threads)):
            motor = thread + k * threads
            a = ti.cast(0, real)
            if motor < n.motors:
                s = b.weights[n.b2 + motor]
                for j in range(HIDDEN // ROWS):
                    for i in ti.static(range(ROWS)):
                        h = ROWS * j + i
                        s += b.transposed[n.w2 + h * n.padded_motors + motor] * m.hidden[h]
                a = tanh(s)
                m.activations[b.body.motor[motor]] = a
            b.history.action[motor] = a

    @ti.func
    def push(thread, b: ti.template()):
        i = cell_of(thread, b)
        b.history.x[i], b.history.y[i] = b.shared.x[i], b.shared.y[i]
        for family in ti.static(range(FAMILIES)):
            f = ti.static(b.shared.forces.of(family))
            cells = spring.ahead(b.body, family)
            spring.push_row(b.now, b.body, b.law, b.shared, f, family, cells, i)

    @ti.func
    def advance(thread, b: ti.template()):
        i = cell_of(thread, b)
        if ti.static(b.law.staggered):
            b.shared.adjacent_vx[i], b.shared.adjacent_vy[i] = b.shared.vx[i], b.shared.vy[i]
        fastest = mass.advance_row(b.now, b.now, b.body, b.law, b.ground, b.shared, i)
        if ti.static(b.ground.contact == FRICTION):
            touch.slide(b.ground, ti.static(b.shared.of(i)), b.before, b.now, i, b.law)
        if not (fastest < FASTEST) and b.launch.status[b.place.robot] < 0:
            b.launch.status[b.place.robot] = b.t

    @ti.func
    def leave(thread, b: ti.template()):
        """The state for the next launch, and what the loss adds up."""
        m, n = ti.static(b.shared, b.n)
        forward = ti.cast(0, real)
        if thread < n.cell_rows:
            for k, column in ti.static(enumerate(m.carry)):
                b.carry[k * n.cell_rows + thread] = column[thread]
            forward = m.x[thread] - b.body.start[thread]
            if ti.static(b.law.staggered):
                forward += 0.5 * (b.history.x[thread] - m.x[thread])
        m.partial[thread] = forward

    @ti.func
    def sum_partial(thread, b: ti.template()):
        sum_parts(thread, b.shared.partial, b.shared.sums, 1)

    @ti.func
    def write_loss(thread, b: ti.template()):
        """Writes the loss, minus the mean forward displacement, and keeps the best weights."""
        settings = ti.static(b.launch.settings)
        first = b.place.robot * (settings.iterations + 1)
        loss = -total(b.shared.sums, 0) * b.body.per_mass
        best = settings.iterations > 0
        for i in range(settings.iteration):
            if not loss < b.launch.losses[first + i]:
                best = False
        if best:
            for k in range(rounds(b.n.weights, thread, threads)):
                b.best[thread + k * threads] = b.weights[thread + k * threads]
        if thread == 0:
            b.launch.losses[first + settings.iteration] = loss

    @ti.func
    def forward(own, block: ti.template(), at: ti.template()):
        """Steps `first` to `end` of a robot; after the last, its loss."""
        settings = ti.static(block.launch.settings)
        phase(begin, own, block)
        for t in range(settings.first, settings.end):
            now = ti.static(at(block, t))
            if block.n.motors > 0:
                if block.law.listening:
                    phase(sum_positions, own, now)
                phase(sense, own, now)
                phase(add_inputs, own, now)
                phase(activate, own, now)
                phase(act, own, now)
            phase(push, own, now)
            phase(advance, own, now)
        phase(leave, own, ti.static(at(block, settings.end - 1)))
        if settings.end == settings.steps and block.launch.status[block.place.robot] < 0:
            phase(sum_partial, own, block)
            phase(write_loss, own, block)

    return SimpleNamespace(
        forward=forward,
        cell_of=cell_of,
        rounds=rounds,
        sum_parts=sum_parts,
        total=total,
        sum_partial=sum_partial,
    )

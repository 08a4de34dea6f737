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
    def fold(thread, values: ti.template(), sums: ti.template(), arrays: ti.template()):
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
        m.x[thread], m.y[thread], m.vx[thread], m.vy[thread] = zero, zero, zero, zero
        if thread < n.cell_rows:
            if b.launch.settings.first == 0:
                m.x[thread], m.y[thread] = b.body.start[thread], b.body.start[n.cell_rows + thread]
                m.vx[thread], m.vy[thread] = b.body.velocity[thread], b.body.velocity[n.cell_rows + thread]
                if ti.static(b.law.staggered):  # positions are half a step ahead
                    m.x[thread] = m.x[thread] + 0.5 * b.law.dt * m.vx[thread]
                    m.y[thread] = m.y[thread] + 0.5 * b.law.dt * m.vy[thread]
                    m.beside_x[thread], m.beside_y[thread] = m.vx[thread], m.vy[thread]
            else:
                c = ti.static(b.carried)
                m.x[thread], m.y[thread] = c[thread], c[n.cell_rows + thread]
                m.vx[thread], m.vy[thread] = c[2 * n.cell_rows + thread], c[3 * n.cell_rows + thread]
                if ti.static(b.law.staggered):
                    m.beside_x[thread] = c[4 * n.cell_rows + thread]
                    m.beside_y[thread] = c[5 * n.cell_rows + thread]
        if ti.static(b.ground.contact == FRICTION):
            touch.forget(m.under, b.body, cell_of(thread, b))
        for f in ti.static(range(FAMILIES)):
            m.activations[f * threads + thread] = zero
            m.forces.x[f * threads + thread], m.forces.y[f * threads + thread] = zero, zero
        for k in range((n.inputs + PARTS - thread + threads - 1) // threads):
            row = thread + k * threads
            m.inputs[row] = ti.select(row == n.inputs, ti.cast(1, real), zero)

    @ti.func
    def fold_positions(thread, b: ti.template()):
        fold(thread, b.shared.x, b.shared.sums, 2)

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
                    vx += 0.5 * (vx - m.beside_x[k])
                    vy += 0.5 * (vy - m.beside_y[k])
                m.inputs[row + 2], m.inputs[row + 3] = vx * law.sense, vy * law.sense

    @ti.func
    def add_inputs(thread, b: ti.template()):
        """W1 u: each group of 32 threads takes every so many eight inputs, each thread a hidden unit."""
        m, n = ti.static(b.shared, b.n)
        group, unit = thread // WARP, thread % WARP
        s = ti.cast(0, real)
        for k in range((n.inputs // ROWS - group + groups - 1) // groups):
            row = ROWS * (group + k * groups)
            for i in ti.static(range(ROWS)):
                s += b.weights[HIDDEN * (row + i) + unit] * m.inputs[row + i]
        m.partial[thread] = s
        for k in range((n.inputs + PARTS - thread + threads - 1) // threads):
            b.kept.inputs[thread + k * threads] = m.inputs[thread + k * threads]

    @ti.func
    def excite(thread, b: ti.template()):
        """h = tanh(W1 u + b1)"""
        m = ti.static(b.shared)
        if thread < HIDDEN:
            s = b.weights[b.n.bias + thread]
            for group in ti.static(range(groups)):
                s += m.partial[WARP * group + thread]
            h = tanh(s)
            m.hidden[thread] = h
            b.kept.hidden[thread] = h

    @ti.func
    def act(thread, b: ti.template()):
        """a = tanh(W2 h + b2), a thread each motor."""
        m, n = ti.static(b.shared, b.n)
        for k in range((n.padded_motors - thread + threads - 1) // threads):
            motor = thread + k * threads
            a = ti.cast(0, real)
            if motor < n.motors:
                s = b.weights[n.b2 + motor]
                for j in range(HIDDEN // ROWS):
                    for i in ti.static(range(ROWS)):
                        h = ROWS * j + i
                        s += b.turned[n.w2 + h * n.padded_motors + motor] * m.hidden[h]
                a = tanh(s)
                m.activations[b.body.motor[motor]] = a
            b.kept.action[motor] = a

    @ti.func
    def push(thread, b: ti.template()):
        i = cell_of(thread, b)
        b.kept.x[i], b.kept.y[i] = b.shared.x[i], b.shared.y[i]
        for family in ti.static(range(FAMILIES)):
            f = ti.static(b.shared.forces.of(family))
            cells = spring.ahead(b.body, family)
            spring.push_row(b.now, b.body, b.law, b.shared, f, family, cells, i)

    @ti.func
    def advance(thread, b: ti.template()):
        i = cell_of(thread, b)
        if ti.static(b.law.staggered):
            b.shared.beside_x[i], b.shared.beside_y[i] = b.shared.vx[i], b.shared.vy[i]
        fastest = mass.advance_row(b.now, b.now, b.body, b.law, b.ground, b.shared, i)
        if ti.static(b.ground.contact == FRICTION):
            touch.slide(b.ground, ti.static(b.shared.of(i)), b.before, b.now, i, b.law)
        if not (fastest < FASTEST) and b.launch.status[b.place.robot] < 0:
            b.launch.status[b.place.robot] = b.t

    @ti.func
    def leave(thread, b: ti.template()):
        """The state for the next launch, and what the loss adds up."""
        m, n, c = ti.static(b.shared, b.n, b.carried)
        forward = ti.cast(0, real)
        if thread < n.cell_rows:
            c[thread], c[n.cell_rows + thread] = m.x[thread], m.y[thread]
            c[2 * n.cell_rows + thread], c[3 * n.cell_rows + thread] = m.vx[thread], m.vy[thread]
            forward = m.x[thread] - b.body.start[thread]
            if ti.static(b.law.staggered):
                c[4 * n.cell_rows + thread], c[5 * n.cell_rows + thread] = (
                    m.beside_x[thread],
                    m.beside_y[thread],
                )
                forward += 0.5 * (b.kept.x[thread] - m.x[thread])
        m.partial[thread] = forward

    @ti.func
    def fold_partial(thread, b: ti.template()):
        fold(thread, b.shared.partial, b.shared.sums, 1)

    @ti.func
    def judge(thread, b: ti.template()):
        """Writes the loss, minus the mean forward displacement, and keeps the best weights."""
        settings = ti.static(b.launch.settings)
        first = b.place.robot * (settings.iterations + 1)
        loss = -total(b.shared.sums, 0) * b.body.per_mass
        best = settings.backward > 0 and settings.iterations > 0
        for i in range(settings.iteration):
            if not loss < b.launch.losses[first + i]:
                best = False
        if best:
            for k in range((b.n.weights - thread + threads - 1) // threads):
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
                    phase(fold_positions, own, now)
                phase(sense, own, now)
                phase(add_inputs, own, now)
                phase(excite, own, now)
                phase(act, own, now)
            phase(push, own, now)
            phase(advance, own, now)
        phase(leave, own, ti.static(at(block, settings.end - 1)))
        if settings.end == settings.steps and block.launch.status[block.place.robot] < 0:
            phase(fold_partial, own, block)
            phase(judge, own, block)

    return SimpleNamespace(
        forward=forward, cell_of=cell_of, fold=fold, total=total, fold_partial=fold_partial
    )

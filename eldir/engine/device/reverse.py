"""The reverse sweep of one robot in phases: the adjoints of `forward`, from the last step to the first."""

from types import SimpleNamespace

from eldir.controller import HIDDEN
from eldir.engine.compiler import ti
from eldir.engine.device.layout import ROWS, STATE, WARP
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels.contact import FRICTION
from eldir.engine.kernels.layout import CPG_ROWS


def functions(
    kind: SimpleNamespace, threads: int, phase: object, spring: SimpleNamespace, mass: SimpleNamespace,
    touch: SimpleNamespace, ahead: SimpleNamespace,
) -> SimpleNamespace:  # fmt: skip
    """`ahead` are the functions of the forward pass."""
    real = kind.real
    groups = threads // WARP

    @ti.func
    def x_gradient(b: ti.template(), i):
        """The gradient of the loss with respect to a mass's last x, or its last but one."""
        return -b.body.per_mass * b.body.mask[i] * (0.5 if ti.static(b.law.staggered) else 1.0)

    @ti.func
    def begin(thread, b: ti.template()):
        m, n, g = ti.static(b.shared, b.n, b.shared.g)
        zero = ti.cast(0, real)
        if ti.static(b.ground.contact == FRICTION):
            touch.forget(m.under, b.body, ahead.cell_of(thread, b))
        for k, column in ti.static(enumerate(m.g_carry)):
            column[thread] = zero
            if b.launch.settings.end < b.launch.settings.steps and thread < n.cell_rows:
                column[thread] = b.carry[k * n.cell_rows + thread]
        if b.launch.settings.end == b.launch.settings.steps and thread < n.cell_rows:
            g.x[thread] = x_gradient(b, thread)
        g.wx[thread], g.wy[thread], m.x[thread], m.y[thread] = zero, zero, zero, zero
        for k in ti.static(range(FAMILIES)):
            m.activations[k * threads + thread] = zero
            m.forces.x[k * threads + thread], m.forces.y[k * threads + thread] = zero, zero

    @ti.func
    def land(thread, b: ti.template()):
        """Back through contact; what the springs need of this step."""
        m, g, n = ti.static(b.shared, b.shared.g, b.n)
        i = ahead.cell_of(thread, b)
        m.x[i], m.y[i] = b.history.x[i], b.history.y[i]
        if b.t + 1 < b.launch.settings.steps and (b.t + 1) % b.launch.settings.window == 0:
            g.x[i] = x_gradient(b, i)
            g.y[i], g.vx[i], g.vy[i] = 0.0, 0.0, 0.0
        mass.advance_adjoint_row(b.now, b.law, b.ground, g, i)
        if ti.static(b.ground.contact == FRICTION):
            m.partial[i] = 1.0  # whether it met the ground is asked again
            touch.slide_adjoint(b.ground, ti.static(m.of(i)), b.before, i, b.law, None)
        g.vx[i], g.vy[i] = b.law.decay * g.wx[i], b.law.decay * g.wy[i]
        for k in range(ahead.rounds(n.motors, thread, threads)):
            motor = thread + k * threads
            m.activations[b.body.motor[motor]] = b.history.action[motor]
        if thread < HIDDEN:
            m.hidden[thread] = b.history.hidden[thread]

    @ti.func
    def push(thread, b: ti.template()):
        m = ti.static(b.shared)
        i = ahead.cell_of(thread, b)
        for family in ti.static(range(FAMILIES)):
            f = ti.static(m.forces.of(family))
            cells = spring.ahead(b.body, family)
            spring.push_adjoint_row(m, b.body, b.law, m, None, f, family, cells, i)

    @ti.func
    def gather(thread, b: ti.template()):
        m, g, n = ti.static(b.shared, b.shared.g, b.n)
        i = ahead.cell_of(thread, b)
        fx, fy = spring.total(m, b.body, i)
        if ti.static(b.law.staggered):  # the loss is of the middle of the last two positions
            fx += ti.select(b.t == b.launch.settings.steps - 1, x_gradient(b, i), ti.cast(0, real))
        g.x[i] = g.x[i] + fx
        g.y[i] = g.y[i] + fy
        for k in range(ahead.rounds(n.padded_motors, thread, threads)):
            motor = thread + k * threads
            delta = ti.cast(0, real)
            if motor < n.motors:
                a = b.history.action[motor]
                delta = m.g_activations[b.body.motor[motor]] * (1.0 - a * a)
            m.inputs[motor] = delta
            b.history.action[motor] = delta

    @ti.func
    def add_motors(thread, b: ti.template()):
        """delta W2: each group of 32 threads takes every so many eight motors, each thread a hidden unit."""
        m, n = ti.static(b.shared, b.n)
        for k in ti.static(range(FAMILIES)):
            m.activations[k * threads + thread] = ti.cast(0, real)
        for k in ti.static(range(STATE)):
            m.sensed[k * threads + thread] = ti.cast(0, real)
        group, unit = thread // WARP, thread % WARP
        s = ti.cast(0, real)
        for k in range(ahead.rounds((n.motors + ROWS - 1) // ROWS, group, groups)):
            motor = ROWS * (group + k * groups)
            for i in ti.static(range(ROWS)):
                s += b.weights[n.w2 + HIDDEN * (motor + i) + unit] * m.inputs[motor + i]
        m.partial[thread] = s

    @ti.func
    def activate(thread, b: ti.template()):
        m = ti.static(b.shared)
        if thread < HIDDEN:
            s = ti.cast(0, real)
            for group in ti.static(range(groups)):
                s += m.partial[WARP * group + thread]
            h = m.hidden[thread]
            s *= 1.0 - h * h
            m.hidden_delta[thread] = s
            b.history.hidden_delta[thread] = s

    @ti.func
    def sense(thread, b: ti.template()):
        """delta W1, a thread each mass."""
        m, n = ti.static(b.shared, b.n)
        if thread < n.masses:
            stride = (n.inputs - CPG_ROWS) // 4
            zero = ti.cast(0, real)
            x, y, vx, vy = zero, zero, zero, zero
            for k in range(HIDDEN // ROWS):
                for i in ti.static(range(ROWS)):
                    h = ROWS * k + i
                    row, d = HIDDEN * CPG_ROWS + 4 * h * stride + thread, m.hidden_delta[h]
                    x += b.transposed[row] * d
                    y += b.transposed[row + stride] * d
                    vx += b.transposed[row + 2 * stride] * d
                    vy += b.transposed[row + 3 * stride] * d
            cell = b.body.cell[thread]
            m.sensed[cell], m.sensed[threads + cell] = x, y
            m.sensed[2 * threads + cell], m.sensed[3 * threads + cell] = vx, vy

    @ti.func
    def sum_sensed(thread, b: ti.template()):
        ahead.sum_parts(thread, b.shared.sensed, b.shared.sums, 2)

    @ti.func
    def add_sensed(thread, b: ti.template()):
        m, g, body = ti.static(b.shared, b.shared.g, b.body)
        sense = b.law.sense
        cx, cy = ahead.total(m.sums, 0) * body.per_mass, ahead.total(m.sums, 1) * body.per_mass
        i = ahead.cell_of(thread, b)
        g.x[i] = g.x[i] + sense * (m.sensed[i] - cx * body.mask[i])
        g.y[i] = g.y[i] + sense * (m.sensed[threads + i] - cy * body.mask[i])
        vx, vy = m.sensed[2 * threads + i], m.sensed[3 * threads + i]
        sense_v = sense
        if ti.static(b.law.staggered):  # the step after this one has sensed these velocities too
            g.vx[i] = g.vx[i] - 0.5 * sense * m.adjacent_vx[i]
            g.vy[i] = g.vy[i] - 0.5 * sense * m.adjacent_vy[i]
            m.adjacent_vx[i], m.adjacent_vy[i] = vx, vy
            sense_v *= ti.select(b.t > 0, 1.5, 1.0)
        g.vx[i] = g.vx[i] + sense_v * vx
        g.vy[i] = g.vy[i] + sense_v * vy

    @ti.func
    def leave(thread, b: ti.template()):
        if thread < b.n.cell_rows:
            for k, column in ti.static(enumerate(b.shared.g_carry)):
                b.carry[k * b.n.cell_rows + thread] = column[thread]

    @ti.func
    def reverse(own, block: ti.template(), at: ti.template()):
        """Steps `end` - 1 down to `first` of a robot."""
        settings = ti.static(block.launch.settings)
        phase(begin, own, block)
        for back in range(settings.end - settings.first):
            t = settings.end - 1 - back
            now = ti.static(at(block, t))
            phase(land, own, now)
            phase(push, own, now)
            phase(gather, own, now)
            phase(add_motors, own, now)
            phase(activate, own, now)
            if block.law.listening:
                phase(sense, own, now)
                phase(sum_sensed, own, now)
                phase(add_sensed, own, now)
        phase(leave, own, block)

    return SimpleNamespace(reverse=reverse)

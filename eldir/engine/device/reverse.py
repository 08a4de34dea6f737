"""The reverse sweep of one robot in phases: the adjoints of `forward`, from the last step to the first."""

from eldir.controller import HIDDEN
from eldir.engine.compiler import ti
from eldir.engine.device.forward import cell_of_thread, stride_count, sum_parts, total
from eldir.engine.device.layout import LARGEST_GRADIENT, ROWS, STATE, WARP
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels.contact import FRICTION, absolute, friction_contact_adjoint, reset_segments
from eldir.engine.kernels.layout import CHUNK, CPG_ROWS
from eldir.engine.kernels.mass_spring import (
    advance_adjoint,
    family_offset,
    net_impulse,
    spring_impulse_adjoint,
)


@ti.func
def final_gradient(robot: ti.template(), i):
    """The gradient of the loss with respect to a mass's last x, or its last but one."""
    return -robot.inverse_count * robot.mask[i] * (0.5 if ti.static(robot.staggered) else 1.0)


@ti.func
def initialize(thread, b: ti.template()):
    m, g, robot = ti.static(b.shared, b.shared.g, b.robot)
    n, threads = ti.static(robot.n, b.threads)
    zero = ti.cast(0, robot.simd.real)
    if ti.static(robot.ground.contact == FRICTION):
        reset_segments(robot, m.segments_below, cell_of_thread(thread, b))
    for k, column in ti.static(enumerate(m.gradient_carry)):
        column[thread] = zero
        if b.launch.settings.end < b.launch.settings.steps and thread < n.cell_rows:
            column[thread] = b.carry[k * n.cell_rows + thread]
    if b.launch.settings.end == b.launch.settings.steps and thread < n.cell_rows:
        g.x[thread] = final_gradient(robot, thread)
        b.carry[LARGEST_GRADIENT * n.cell_rows + thread] = zero
    g.wx[thread], g.wy[thread], m.x[thread], m.y[thread] = zero, zero, zero, zero
    for k in ti.static(range(FAMILIES)):
        m.activations[k * threads + thread] = zero
        m.forces.x[k * threads + thread], m.forces.y[k * threads + thread] = zero, zero


@ti.func
def note_gradient(b: ti.template(), i, state):
    """Looks at the gradient of a mass's position in this state where the CPU does (`learning_kernel`)."""
    settings, g = ti.static(b.launch.settings, b.shared.g)
    back = settings.steps - state
    if back > 0 and (back % CHUNK == 0 or state % settings.window == 0):
        k = LARGEST_GRADIENT * b.robot.n.cell_rows + i
        b.carry[k] = ti.max(b.carry[k], ti.max(absolute(g.x[i]), absolute(g.y[i])))


@ti.func
def advance_masses_adjoint(thread, b: ti.template()):
    """Back through contact and motion; loads what the springs need of this step."""
    m, g, robot = ti.static(b.shared, b.shared.g, b.robot)
    i = cell_of_thread(thread, b)
    m.x[i], m.y[i] = b.history.x[i], b.history.y[i]
    note_gradient(b, i, b.t + 1)
    if b.t + 1 < b.launch.settings.steps and (b.t + 1) % b.launch.settings.window == 0:
        g.x[i] = final_gradient(robot, i)
        g.y[i], g.vx[i], g.vy[i] = 0.0, 0.0, 0.0
    advance_adjoint(robot, b.now, g, i)
    if ti.static(robot.ground.contact == FRICTION):
        m.partial[i] = 1.0  # whether it hit the ground is computed again
        friction_contact_adjoint(robot, ti.static(m.for_thread(i)), b.before, i)
    g.vx[i], g.vy[i] = robot.decay * g.wx[i], robot.decay * g.wy[i]
    for k in range(stride_count(robot.n.motors, thread, b.threads)):
        motor = thread + k * b.threads
        m.activations[robot.motor[motor]] = b.history.action[motor]
    if thread < HIDDEN:
        m.hidden[thread] = b.history.hidden[thread]


@ti.func
def spring_impulses_adjoint(thread, b: ti.template()):
    m = ti.static(b.shared)
    i = cell_of_thread(thread, b)
    for family in ti.static(range(FAMILIES)):
        f = ti.static(m.forces.family(family))
        cells = family_offset(b.robot, family)
        spring_impulse_adjoint(b.robot, m, m, f, family, cells, i)


@ti.func
def position_gradients(thread, b: ti.template()):
    """Gradients of the positions, and the deltas of the motors."""
    m, g, robot = ti.static(b.shared, b.shared.g, b.robot)
    n, threads = ti.static(robot.n, b.threads)
    i = cell_of_thread(thread, b)
    fx, fy = net_impulse(robot, m, i)
    if ti.static(robot.staggered):  # the loss is of the middle of the last two positions
        fx += ti.select(
            b.t == b.launch.settings.steps - 1, final_gradient(robot, i), ti.cast(0, robot.simd.real)
        )
    g.x[i] = g.x[i] + fx
    g.y[i] = g.y[i] + fy
    for k in range(stride_count(n.padded_motors, thread, threads)):
        motor = thread + k * threads
        delta = ti.cast(0, robot.simd.real)
        if motor < n.motors:
            a = b.history.action[motor]
            delta = m.g_activations[robot.motor[motor]] * (1.0 - a * a)
        m.inputs[motor] = delta
        b.history.action[motor] = delta


@ti.func
def sum_motor_deltas(thread, b: ti.template()):
    """delta W2: each group of 32 threads takes every so many eight motors, each thread a hidden unit."""
    m, n, threads = ti.static(b.shared, b.robot.n, b.threads)
    groups = ti.static(threads // WARP)
    for k in ti.static(range(FAMILIES)):
        m.activations[k * threads + thread] = ti.cast(0, b.robot.simd.real)
    for k in ti.static(range(STATE)):
        m.sensed[k * threads + thread] = ti.cast(0, b.robot.simd.real)
    group, unit = thread // WARP, thread % WARP
    s = ti.cast(0, b.robot.simd.real)
    for k in range(stride_count((n.motors + ROWS - 1) // ROWS, group, groups)):
        motor = ROWS * (group + k * groups)
        for i in ti.static(range(ROWS)):
            s += b.weights[n.w2 + HIDDEN * (motor + i) + unit] * m.inputs[motor + i]
    m.partial[thread] = s


@ti.func
def hidden_deltas(thread, b: ti.template()):
    """Gradients of the hidden units before tanh."""
    m = ti.static(b.shared)
    if thread < HIDDEN:
        s = ti.cast(0, b.robot.simd.real)
        for group in ti.static(range(b.threads // WARP)):
            s += m.partial[WARP * group + thread]
        h = m.hidden[thread]
        s *= 1.0 - h * h
        m.hidden_delta[thread] = s
        b.history.hidden_delta[thread] = s


@ti.func
def sensed_gradients(thread, b: ti.template()):
    """delta W1, a thread each mass."""
    m, n, threads = ti.static(b.shared, b.robot.n, b.threads)
    if thread < n.masses:
        stride = (n.inputs - CPG_ROWS) // 4
        zero = ti.cast(0, b.robot.simd.real)
        x, y, vx, vy = zero, zero, zero, zero
        for k in range(HIDDEN // ROWS):
            for i in ti.static(range(ROWS)):
                h = ROWS * k + i
                row, d = HIDDEN * CPG_ROWS + 4 * h * stride + thread, m.hidden_delta[h]
                x += b.transposed[row] * d
                y += b.transposed[row + stride] * d
                vx += b.transposed[row + 2 * stride] * d
                vy += b.transposed[row + 3 * stride] * d
        cell = b.robot.cell[thread]
        m.sensed[cell], m.sensed[threads + cell] = x, y
        m.sensed[2 * threads + cell], m.sensed[3 * threads + cell] = vx, vy


@ti.func
def sum_sensed(thread, b: ti.template()):
    sum_parts(thread, b, b.shared.sensed, 2)


@ti.func
def add_sensed_gradients(thread, b: ti.template()):
    """Adds the gradients of what was sensed to those of x and v."""
    m, g, robot = ti.static(b.shared, b.shared.g, b.robot)
    threads = ti.static(b.threads)
    scale = robot.sensing_scale
    cx, cy = total(b, 0) * robot.inverse_count, total(b, 1) * robot.inverse_count
    i = cell_of_thread(thread, b)
    g.x[i] = g.x[i] + scale * (m.sensed[i] - cx * robot.mask[i])
    g.y[i] = g.y[i] + scale * (m.sensed[threads + i] - cy * robot.mask[i])
    vx, vy = m.sensed[2 * threads + i], m.sensed[3 * threads + i]
    velocity_scale = scale
    if ti.static(robot.staggered):  # the step after this one has sensed these velocities too
        g.vx[i] = g.vx[i] - 0.5 * scale * m.adjacent_vx[i]
        g.vy[i] = g.vy[i] - 0.5 * scale * m.adjacent_vy[i]
        m.adjacent_vx[i], m.adjacent_vy[i] = vx, vy
        velocity_scale *= ti.select(b.t > 0, 1.5, 1.0)
    g.vx[i] = g.vx[i] + velocity_scale * vx
    g.vy[i] = g.vy[i] + velocity_scale * vy


@ti.func
def save_gradients(thread, b: ti.template()):
    """Writes the gradients for the next launch."""
    if thread < b.robot.n.cell_rows:
        if b.launch.settings.first == 0:
            note_gradient(b, thread, 0)
        for k, column in ti.static(enumerate(b.shared.gradient_carry)):
            b.carry[k * b.robot.n.cell_rows + thread] = column[thread]


@ti.func
def reverse(thread, block: ti.template()):
    """Steps `end` - 1 down to `first` of a robot."""
    settings = ti.static(block.launch.settings)
    block.phase(initialize, thread, block)
    for back in range(settings.end - settings.first):
        t = settings.end - 1 - back
        now = ti.static(block.at_step(t))
        block.phase(advance_masses_adjoint, thread, now)
        block.phase(spring_impulses_adjoint, thread, now)
        block.phase(position_gradients, thread, now)
        block.phase(sum_motor_deltas, thread, now)
        block.phase(hidden_deltas, thread, now)
        if block.robot.closed_loop:
            block.phase(sensed_gradients, thread, now)
            block.phase(sum_sensed, thread, now)
            block.phase(add_sensed_gradients, thread, now)
    block.phase(save_gradients, thread, block)

"""The forward pass of one robot in phases: the counterpart of `rollout` and `actuate` of the CPU's kernels.

A phase is what every thread of a block does between two barriers (`kernels.phase_of`); `b` is a `Block`.
"""

from eldir.controller import HIDDEN
from eldir.engine.compiler import ti
from eldir.engine.device.layout import PARTS, ROWS, WARP
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels.contact import FRICTION, friction_contact, reset_segments
from eldir.engine.kernels.layout import CPG_ROWS
from eldir.engine.kernels.mass_spring import advance, family_offset, spring_impulse
from eldir.engine.validity import MAX_SQUARE, OK


@ti.func
def cell_of_thread(thread, b: ti.template()):
    """The cell that a thread computes: threads beyond the grid repeat its last cell, which is empty.

    With a condition instead, the compilers lead the threads beyond past the next phase, to a copy of the
    barrier of their own. Threads of one warp must meet at the same one."""
    return ti.min(thread, b.robot.n.cell_rows - 1)


@ti.func
def stride_count(count, first, step: ti.template()):
    """How many of `first`, `first` + `step`, ... are less than `count`."""
    return (count - first + step - 1) // step


@ti.func
def sum_parts(thread, b: ti.template(), values: ti.template(), arrays: ti.template()):
    """Partial sums of arrays of one value for each thread that lie one after the other."""
    if thread < arrays * PARTS:
        first = thread // PARTS * b.threads + thread % PARTS
        s = ti.cast(0, b.robot.simd.real)
        for k in ti.static(range(b.threads // PARTS)):
            s += values[first + PARTS * k]
        b.shared.sums[thread] = s


@ti.func
def total(b: ti.template(), array: ti.template()):
    """Sum of the partial sums of an array."""
    s = ti.cast(0, b.robot.simd.real)
    for k in ti.static(range(PARTS)):
        s += b.shared.sums[PARTS * array + k]
    return s


@ti.func
def initialize(thread, b: ti.template()):
    m, robot, threads = ti.static(b.shared, b.robot, b.threads)
    n = ti.static(robot.n)
    zero = ti.cast(0, robot.simd.real)
    for k, column in ti.static(enumerate(m.carry)):
        column[thread] = zero
        if b.launch.settings.first > 0 and thread < n.cell_rows:
            column[thread] = b.carry[k * n.cell_rows + thread]
    if b.launch.settings.first == 0 and thread < n.cell_rows:
        x, y = robot.start[thread], robot.start[n.cell_rows + thread]
        vx, vy = robot.velocity[thread], robot.velocity[n.cell_rows + thread]
        if ti.static(robot.staggered):  # positions are half a step ahead
            x, y = x + 0.5 * robot.dt * vx, y + 0.5 * robot.dt * vy
            m.adjacent_vx[thread], m.adjacent_vy[thread] = vx, vy
        m.x[thread], m.y[thread], m.vx[thread], m.vy[thread] = x, y, vx, vy
    if ti.static(robot.ground.contact == FRICTION):
        reset_segments(robot, m.segments_below, cell_of_thread(thread, b))
    for f in ti.static(range(FAMILIES)):
        m.activations[f * threads + thread] = zero
        m.forces.x[f * threads + thread], m.forces.y[f * threads + thread] = zero, zero
    for k in range(stride_count(n.input_values, thread, threads)):
        row = thread + k * threads
        m.inputs[row] = ti.select(row == n.inputs, ti.cast(1, robot.simd.real), zero)


@ti.func
def sum_positions(thread, b: ti.template()):
    sum_parts(thread, b, b.shared.x, 2)


@ti.func
def sense(thread, b: ti.template()):
    """The pattern generators; displacement of every mass from the centre of mass, and velocity."""
    m, robot = ti.static(b.shared, b.robot)
    if thread < CPG_ROWS:
        m.inputs[thread] = robot.cpgs[CPG_ROWS * b.t + thread]
    if robot.closed_loop:
        cx, cy = total(b, 0) * robot.inverse_count, total(b, 1) * robot.inverse_count
        if thread < robot.n.masses:
            k, row = robot.cell[thread], CPG_ROWS + 4 * thread
            m.inputs[row] = (m.x[k] - cx - robot.reference[k]) * robot.sensing_scale
            m.inputs[row + 1] = (m.y[k] - cy - robot.reference[robot.n.cell_rows + k]) * robot.sensing_scale
            vx, vy = m.vx[k], m.vy[k]
            if ti.static(robot.staggered):  # half a step later, as positions are
                vx += 0.5 * (vx - m.adjacent_vx[k])
                vy += 0.5 * (vy - m.adjacent_vy[k])
            m.inputs[row + 2], m.inputs[row + 3] = vx * robot.sensing_scale, vy * robot.sensing_scale


@ti.func
def sum_inputs(thread, b: ti.template()):
    """W1 u: each group of 32 threads takes every so many eight inputs, each thread a hidden unit."""
    m, n, threads = ti.static(b.shared, b.robot.n, b.threads)
    groups = ti.static(threads // WARP)
    group, unit = thread // WARP, thread % WARP
    s = ti.cast(0, b.robot.simd.real)
    for k in range(stride_count(n.inputs // ROWS, group, groups)):
        row = ROWS * (group + k * groups)
        for i in ti.static(range(ROWS)):
            s += b.weights[HIDDEN * (row + i) + unit] * m.inputs[row + i]
    m.partial[thread] = s
    for k in range(stride_count(n.input_values, thread, threads)):
        b.history.inputs[thread + k * threads] = m.inputs[thread + k * threads]


@ti.func
def hidden_units(thread, b: ti.template()):
    """h = tanh(W1 u + b1)"""
    m = ti.static(b.shared)
    if thread < HIDDEN:
        s = b.weights[b.robot.n.bias + thread]
        for group in ti.static(range(b.threads // WARP)):
            s += m.partial[WARP * group + thread]
        h = b.robot.simd.tanh(s)
        m.hidden[thread] = h
        b.history.hidden[thread] = h


@ti.func
def actuate(thread, b: ti.template()):
    """a = tanh(W2 h + b2), a thread each motor."""
    m, n, threads = ti.static(b.shared, b.robot.n, b.threads)
    for k in range(stride_count(n.padded_motors, thread, threads)):
        motor = thread + k * threads
        a = ti.cast(0, b.robot.simd.real)
        if motor < n.motors:
            s = b.weights[n.b2 + motor]
            for j in range(HIDDEN // ROWS):
                for i in ti.static(range(ROWS)):
                    h = ROWS * j + i
                    s += b.transposed[n.w2 + h * n.padded_motors + motor] * m.hidden[h]
            a = b.robot.simd.tanh(s)
            m.activations[b.robot.motor[motor]] = a
        b.history.action[motor] = a


@ti.func
def spring_impulses(thread, b: ti.template()):
    i = cell_of_thread(thread, b)
    b.history.x[i], b.history.y[i] = b.shared.x[i], b.shared.y[i]
    for family in ti.static(range(FAMILIES)):
        f = ti.static(b.shared.forces.family(family))
        cells = family_offset(b.robot, family)
        spring_impulse(b.robot, b.now, b.shared, f, family, cells, i)


@ti.func
def advance_masses(thread, b: ti.template()):
    robot = ti.static(b.robot)
    i = cell_of_thread(thread, b)
    if ti.static(robot.staggered):
        b.shared.adjacent_vx[i], b.shared.adjacent_vy[i] = b.shared.vx[i], b.shared.vy[i]
    speed = advance(robot, b.now, b.now, b.shared, i)
    if ti.static(robot.ground.contact == FRICTION):
        friction_contact(robot, ti.static(b.shared.for_thread(i)), b.before, b.now, i)
    if not (speed < robot.max_squared_speed) and b.launch.status[b.at.robot] == OK:
        b.launch.status[b.at.robot] = b.t


@ti.func
def save_state(thread, b: ti.template()):
    """Writes the state for the next launch, and each mass's part of the loss."""
    m, n = ti.static(b.shared, b.robot.n)
    forward = ti.cast(0, b.robot.simd.real)
    if thread < n.cell_rows:
        for k, column in ti.static(enumerate(m.carry)):
            b.carry[k * n.cell_rows + thread] = column[thread]
        forward = m.x[thread] - b.robot.start[thread]
        if ti.static(b.robot.staggered):
            forward += 0.5 * (b.history.x[thread] - m.x[thread])
    m.partial[thread] = forward


@ti.func
def sum_partial(thread, b: ti.template()):
    sum_parts(thread, b, b.shared.partial, 1)


@ti.func
def write_loss(thread, b: ti.template()):
    """Writes the loss, minus the mean forward displacement. Where no gradient follows, keeps the best
    weights."""
    settings = ti.static(b.launch.settings)
    loss = -total(b, 0) * b.robot.inverse_count
    if loss * loss < MAX_SQUARE:
        if settings.iteration == settings.iterations or b.robot.n.motors == 0:
            keep_best(thread, b, loss)
        if thread == 0:
            b.launch.losses[loss_index(b)] = loss
    elif thread == 0:
        b.launch.status[b.at.robot] = settings.steps - 1


@ti.func
def loss_index(b: ti.template()):
    """Where this iteration's loss is, and the growth of its gradient."""
    return b.at.robot * (b.launch.settings.iterations + 1) + b.launch.settings.iteration


@ti.func
def keep_best(thread, b: ti.template(), loss):
    """Keeps the weights of a loss if it is less than all before."""
    settings = ti.static(b.launch.settings)
    best = settings.iterations > 0
    for i in range(settings.iteration):
        if not loss < b.launch.losses[loss_index(b) - 1 - i]:
            best = False
    if best:
        for k in range(stride_count(b.robot.n.weights, thread, b.threads)):
            b.best[thread + k * b.threads] = b.weights[thread + k * b.threads]


@ti.func
def forward(thread, block: ti.template()):
    """Steps `first` to `end` of a robot; after the last, its loss."""
    settings = ti.static(block.launch.settings)
    block.phase(initialize, thread, block)
    for t in range(settings.first, settings.end):
        now = ti.static(block.at_step(t))
        if block.robot.n.motors > 0:
            if block.robot.closed_loop:
                block.phase(sum_positions, thread, now)
            block.phase(sense, thread, now)
            block.phase(sum_inputs, thread, now)
            block.phase(hidden_units, thread, now)
            block.phase(actuate, thread, now)
        block.phase(spring_impulses, thread, now)
        block.phase(advance_masses, thread, now)
    block.phase(save_state, thread, ti.static(block.at_step(settings.end - 1)))
    if settings.end == settings.steps and block.launch.status[block.at.robot] == OK:
        block.phase(sum_partial, thread, block)
        block.phase(write_loss, thread, block)

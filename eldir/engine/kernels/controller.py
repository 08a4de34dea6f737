"""The neural controller, forward and adjoint (paper, Sect. Neural control).

u are the inputs, h = tanh(W1 u + b1) the 32 hidden units, which vectors run over, and a = tanh(W2 h + b2) the
activations of the motors.
"""

from eldir.engine.compiler import ti
from eldir.engine.kernels.layout import CPG_ROWS
from eldir.engine.kernels.simd import fill, one, quad_component


@ti.func
def tanh_rows(simd: ti.template(), column: ti.template(), blocks):
    """tanh in place, of blocks of 32 values."""
    for b in range(blocks):
        column.row[b] = simd.tanh(column.row[b])


@ti.func
def weighted_sum(robot: ti.template(), weights: ti.template(), x: ti.template(), count):
    """sum_i weights.row[i] x[i] over `count` rows, four at a time (padding is 0), in one sum or four."""
    simd = ti.static(robot.simd)
    a, b, c, d = simd.row(0.0), simd.row(0.0), simd.row(0.0), simd.row(0.0)
    i, four = 0, 4 * one(robot.n.masses)
    while i < count:
        a += weights.row[i] * x.each[i]
        if ti.static(simd.wide):
            b += weights.row[i + 1] * x.each[i + 1]
            c += weights.row[i + 2] * x.each[i + 2]
            d += weights.row[i + 3] * x.each[i + 3]
        else:
            for j in ti.static(range(1, 4)):
                a += weights.row[i + j] * x.each[i + j]
        i += four
    return (a + b) + (c + d)


@ti.func
def weighted_sum_of_masses(robot: ti.template(), weights: ti.template(), x: ti.template()):
    """The same over what is sensed of the masses, x, y, vx, vy of each."""
    simd, n = ti.static(robot.simd, robot.n)
    a, b, c, d = simd.row(0.0), simd.row(0.0), simd.row(0.0), simd.row(0.0)
    cells = n.cells
    m, next_mass = 0, one(n.masses)
    while m < n.masses:
        i, k = 4 * m, robot.cell.each[m]
        a += weights.row[i] * x.each[k]
        if ti.static(simd.wide):
            b += weights.row[i + 1] * x.each[k + cells]
            c += weights.row[i + 2] * x.each[k + 2 * cells]
            d += weights.row[i + 3] * x.each[k + 3 * cells]
        else:
            for j in ti.static(range(1, 4)):
                a += weights.row[i + j] * x.each[k + j * cells]
        m += next_mass
    return (a + b) + (c + d)


@ti.func
def transpose(matrix: ti.template(), i, out: ti.template(), j):
    """Row i becomes column j of a matrix that lies in blocks of 32 columns."""
    block, column = j >> 5, j & 31
    for h in range(32):
        out.each[(32 * block + h) * 32 + column] = matrix.each[32 * i + h]


@ti.func
def transpose_weights(robot: ti.template()):
    """Transposed copies of the weights, so that no sum runs across a vector."""
    n, weights, work = ti.static(robot.n, robot.weights, robot.work)
    for m in range(n.padded_motors):
        transpose(weights.w2, m, work.w2_transposed, m)
    if robot.closed_loop:
        for i in range(32 * n.mass_blocks):
            work.w1_transposed.row[i] = robot.simd.row(0.0)
        for i in range(4 * n.masses):
            transpose(weights.w1, i, work.w1_transposed, i)


@ti.func
def sense(robot: ti.template(), now: ti.template(), before: ti.template(), t, inputs: ti.template()):
    """The controller's inputs: the pattern generators and, in a closed loop, the masses."""
    nm = robot.n.cell_rows
    inputs[4 * nm] = robot.cpgs[t]
    if robot.closed_loop:
        sense_masses(robot, now, before, inputs)


@ti.func
def sense_masses(robot: ti.template(), now: ti.template(), before: ti.template(), inputs: ti.template()):
    """Displacement of every mass from the centre of mass, and velocity."""
    sx, sy = robot.simd.lanes(0.0), robot.simd.lanes(0.0)
    for i in range(robot.n.cell_rows):
        sx += now.x[i]
        sy += now.y[i]
    cx, cy = sx.sum() * robot.inverse_count, sy.sum() * robot.inverse_count
    nm = robot.n.cell_rows
    for i in range(nm):
        scale = robot.sensing_scale * robot.mask[i]
        inputs[i] = (now.x[i] - cx - robot.reference[i]) * scale
        inputs[nm + i] = (now.y[i] - cy - robot.reference[nm + i]) * scale
        vx, vy = now.vx[i], now.vy[i]
        if ti.static(robot.staggered):  # half a step later, as positions are
            vx += 0.5 * (vx - before.vx[i])
            vy += 0.5 * (vy - before.vy[i])
        inputs[2 * nm + i] = vx * scale
        inputs[3 * nm + i] = vy * scale


@ti.func
def actuate(robot: ti.template(), now: ti.template(), before: ti.template(), t):
    """Activations of the motors: h = tanh(W1 u + b1), a = tanh(W2 h + b2)."""
    simd, n, weights, work = ti.static(robot.simd, robot.n, robot.weights, robot.work)
    sense(robot, now, before, t, work.inputs)
    hidden = weights.b1.row[0] + weighted_sum(robot, weights.cpgs, work.inputs + 4 * n.cells, 12)
    if robot.closed_loop:
        hidden += weighted_sum_of_masses(robot, weights.w1, work.inputs)
    now.hidden.row[0] = hidden
    tanh_rows(simd, now.hidden, 1)
    for b in range(n.motor_blocks):
        now.action.row[b] = weights.b2.row[b] + weighted_sum(
            robot, work.w2_transposed + 1024 * b, now.hidden, 32
        )
    tanh_rows(simd, now.action, n.motor_blocks)


@ti.func
def clear_sensed_gradients(robot: ti.template()):
    """Clears the gradients of what later steps have sensed."""
    fill(robot.simd, robot.work.g_sensed, 4 * robot.n.cell_rows, 0.0)


@ti.func
def actuate_adjoint(robot: ti.template(), now: ti.template(), before: ti.template(), t, slot):
    """Propagates the deltas of the activations to the gradients of x and v. What the weights' gradients need
    is kept in a slot of the chunk (`add_weight_gradients`)."""
    n, work = ti.static(robot.n, robot.work)
    hidden_delta = ti.static(work.hidden_deltas + 32 * slot)
    h = now.hidden.row[0]
    g_hidden = weighted_sum(robot, robot.weights.w2, work.action_deltas + slot * n.padded_motors, n.motors)
    hidden_delta.row[0] = g_hidden * (1.0 - h * h)
    if robot.closed_loop:
        sense_adjoint(robot, hidden_delta, t)
    sense(robot, now, before, t, work.chunk_inputs + slot * n.input_values)


@ti.func
def sense_adjoint(robot: ti.template(), hidden_delta: ti.template(), t):
    """Propagates the hidden units' deltas to the gradients of x and v."""
    simd, n, work, g = ti.static(robot.simd, robot.n, robot.work, robot.work.g)
    sensed = ti.static(work.g_sensed)
    if ti.static(robot.staggered):  # the step after this one has sensed these velocities too
        for i in range(n.cell_rows):
            g.vx[i] = g.vx[i] - 0.5 * robot.sensing_scale * quad_component(simd, sensed, i, 2)
            g.vy[i] = g.vy[i] - 0.5 * robot.sensing_scale * quad_component(simd, sensed, i, 3)
    for b in range(n.mass_blocks):
        work.g_inputs.row[b] = weighted_sum(robot, work.w1_transposed + 1024 * b, hidden_delta, 32)
    for m in range(n.masses):
        sensed.quad[robot.cell.each[m]] = work.g_inputs.quad[m]
    add_sensed_gradients(robot, sensed, t)


@ti.func
def add_sensed_gradients(robot: ti.template(), sensed: ti.template(), t):
    """Adds the gradients of what was sensed, displacements from the centre of mass and velocities, to those
    of x and v."""
    simd, n, g = ti.static(robot.simd, robot.n, robot.work.g)
    velocity_scale = robot.sensing_scale
    if ti.static(robot.staggered):
        velocity_scale *= ti.select(t > 0, 1.5, 1.0)
    sx, sy = simd.lanes(0.0), simd.lanes(0.0)
    for i in range(n.cell_rows):
        gx, gy = quad_component(simd, sensed, i, 0), quad_component(simd, sensed, i, 1)
        sx += gx
        sy += gy
        g.x[i] = g.x[i] + robot.sensing_scale * gx
        g.y[i] = g.y[i] + robot.sensing_scale * gy
        g.vx[i] = g.vx[i] + velocity_scale * quad_component(simd, sensed, i, 2)
        g.vy[i] = g.vy[i] + velocity_scale * quad_component(simd, sensed, i, 3)
    cx, cy = (
        sx.sum() * robot.inverse_count * robot.sensing_scale,
        sy.sum() * robot.inverse_count * robot.sensing_scale,
    )
    for i in range(n.cell_rows):
        g.x[i] = g.x[i] - cx * robot.mask[i]
        g.y[i] = g.y[i] - cy * robot.mask[i]


@ti.func
def add_outer_products(
    simd: ti.template(), x: ti.template(), x_stride, rows: ti.template(), row_stride, steps,
    out: ti.template(), count,
):  # fmt: skip
    """out.row[i] += sum_t x[t][i] rows[t] for i < count, eight at a time."""
    for block in range((count + 7) >> 3):
        o = 8 * block
        add_eight(simd, x, x_stride, (o, o + 1, o + 2, o + 3, o + 4, o + 5, o + 6, o + 7),
                  rows, row_stride, steps, out + 32 * o)  # fmt: skip


@ti.func
def add_outer_products_of_masses(
    robot: ti.template(), x: ti.template(), rows: ti.template(), steps, out: ti.template()
):
    """The same of what was sensed of the masses, x, y, vx, vy of each, two masses at a time."""
    n = ti.static(robot.n)
    c = n.cells
    for pair in range(n.mass_pairs):
        j, k = robot.cell.each[2 * pair], robot.cell.each[2 * pair + 1]
        add_eight(robot.simd, x, n.input_values,
                  (j, j + c, j + 2 * c, j + 3 * c, k, k + c, k + 2 * c, k + 3 * c),
                  rows, 1, steps, out + 256 * pair)  # fmt: skip


@ti.func
def add_eight(
    simd: ti.template(), x: ti.template(), x_stride, i: ti.template(), rows: ti.template(), row_stride, steps,
    out: ti.template(),
):  # fmt: skip
    """out.row[k] += sum_t x[t][i[k]] rows[t] for eight k, all at once or one after the other."""
    if ti.static(simd.wide):
        s0, s1, s2, s3 = out.row[0], out.row[1], out.row[2], out.row[3]
        s4, s5, s6, s7 = out.row[4], out.row[5], out.row[6], out.row[7]
        for t in range(steps):
            d = rows.row[t * row_stride]
            k = t * x_stride
            s0 += d * x.each[k + i[0]]
            s1 += d * x.each[k + i[1]]
            s2 += d * x.each[k + i[2]]
            s3 += d * x.each[k + i[3]]
            s4 += d * x.each[k + i[4]]
            s5 += d * x.each[k + i[5]]
            s6 += d * x.each[k + i[6]]
            s7 += d * x.each[k + i[7]]
        out.row[0], out.row[1], out.row[2], out.row[3] = s0, s1, s2, s3
        out.row[4], out.row[5], out.row[6], out.row[7] = s4, s5, s6, s7
    else:
        next_step = one(x_stride)
        for j in ti.static(range(8)):
            s = out.row[j]
            t = 0
            while t < steps:
                s += rows.row[t * row_stride] * x.each[t * x_stride + i[j]]
                t += next_step
            out.row[j] = s


@ti.func
def add_weight_gradients(robot: ti.template(), latest: ti.template(), stride, steps):
    """Adds the weight gradients of a chunk of steps, `latest` first, whose deltas and inputs were kept."""
    simd, n, work, g = ti.static(robot.simd, robot.n, robot.work, robot.work.g_weights)
    deltas, inputs = ti.static(work.hidden_deltas, work.chunk_inputs)
    add_outer_products(simd, inputs + 4 * n.cells, n.input_values, deltas, 1, steps, g.cpgs, CPG_ROWS)
    if robot.closed_loop:
        add_outer_products_of_masses(robot, inputs, deltas, steps, g.w1)
    add_outer_products(
        simd, work.action_deltas, n.padded_motors, latest.hidden, -(stride >> 5), steps, g.w2, n.motors
    )
    for t in range(steps):
        g.b1.row[0] = g.b1.row[0] + deltas.row[t]
        for b in range(n.motor_blocks):
            g.b2.row[b] = g.b2.row[b] + work.action_deltas.row[t * n.motor_blocks + b]

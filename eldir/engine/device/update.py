"""Transposed weights, the weights' gradient as a matrix product over all steps, and the update, in phases."""

from eldir.controller import HIDDEN
from eldir.engine.compiler import ti
from eldir.engine.device.forward import keep_best, loss_index, stride_count, sum_partial, total
from eldir.engine.device.layout import LARGEST_GRADIENT, WARP
from eldir.engine.kernels.layout import CPG_ROWS
from eldir.engine.kernels.memory import local
from eldir.engine.validity import MAX_SQUARE, NO_GRADIENT

_ROWS, _UNITS = 8, 4
"""Weights of one thread while it adds up their gradients: so many inputs times so many hidden units."""
_THREADS_ACROSS = HIDDEN // _UNITS
"""Threads side by side for all hidden units."""
_TILE = WARP // _THREADS_ACROSS * _ROWS
"""Inputs of 32 threads together."""
STEPS_AT_ONCE = 2
"""Steps whose numbers a thread loads before it multiplies them."""


@ti.func
def transpose_weights(thread, b: ti.template()):
    """Transposed copies of W1, by mass, and of W2, by motor: no sum runs across threads."""
    n, threads = ti.static(b.robot.n, b.threads)
    first, stride = CPG_ROWS * HIDDEN, (n.inputs - CPG_ROWS) // 4
    for k in range(stride_count(n.bias - first, thread, threads)):
        e = thread + k * threads
        i, h = e // HIDDEN, e % HIDDEN
        b.transposed[first + (4 * h + i % 4) * stride + i // 4] = b.weights[first + e]
    for k in range(stride_count(n.b2 - n.w2, thread, threads)):
        e = thread + k * threads
        b.transposed[n.w2 + e % HIDDEN * n.padded_motors + e // HIDDEN] = b.weights[n.w2 + e]


@ti.func
def transpose(thread, block: ti.template()):
    block.phase(transpose_weights, thread, block)


@ti.func
def matrix_product(
    thread, b: ti.template(), rows: ti.template(), count, columns: ti.template(), out: ti.template()
):
    """out[i, h] = sum_t rows[t][i] columns[t][h] for i < count: 32 x 32 for each group of threads."""
    group, lane = thread // WARP, thread % WARP
    groups = ti.static(b.threads // WARP)
    steps, stride = b.launch.settings.steps, b.robot.n.step_values
    for k in range(stride_count((count + _TILE - 1) // _TILE, group, groups)):
        row = _TILE * (group + k * groups) + _ROWS * (lane // _THREADS_ACROSS)
        unit = _UNITS * (lane % _THREADS_ACROSS)
        sums = ti.static([local(ti.cast(0, b.robot.simd.real)) for _ in range(_ROWS * _UNITS)])
        if row < count:
            for t in range(steps // STEPS_AT_ONCE):
                for j in ti.static(range(STEPS_AT_ONCE)):
                    add_outer_product(rows, row, columns, unit, (STEPS_AT_ONCE * t + j) * stride, sums)
            for t in range(steps // STEPS_AT_ONCE * STEPS_AT_ONCE, steps):
                add_outer_product(rows, row, columns, unit, t * stride, sums)
            for i in ti.static(range(_ROWS)):
                if row + i < count:
                    for j in ti.static(range(_UNITS)):
                        out[HIDDEN * (row + i) + unit + j] = sums[_UNITS * i + j]


@ti.func
def add_outer_product(rows: ti.template(), row, columns: ti.template(), unit, at, sums: ti.template()):
    x = ti.static([local(rows[at + row + i]) for i in range(_ROWS)])
    d = ti.static([local(columns[at + unit + j]) for j in range(_UNITS)])
    for i in ti.static(range(_ROWS)):
        for j in ti.static(range(_UNITS)):
            sums[_UNITS * i + j] += x[i] * d[j]


@ti.func
def input_weight_gradients(thread, b: ti.template()):
    """The gradients of W1 and, as the weights of an input 1, of b1."""
    matrix_product(thread, b, b.history.inputs, b.robot.n.inputs + 1, b.history.hidden_delta, b.g_weights)


@ti.func
def motor_weight_gradients(thread, b: ti.template()):
    """The gradients of W2 and b2."""
    n, threads = ti.static(b.robot.n, b.threads)
    matrix_product(thread, b, b.history.action, n.padded_motors, b.history.hidden, b.g_weights + n.w2)
    for k in range(stride_count(n.padded_motors, thread, threads)):
        motor = thread + k * threads
        s = ti.cast(0, b.robot.simd.real)
        for t in range(b.launch.settings.steps):
            s += b.history.action[t * n.step_values + motor]
        b.g_weights[n.b2 + motor] = s


@ti.func
def write_gradient(thread, b: ti.template()):
    for k in range(stride_count(b.robot.n.weights, thread, b.threads)):
        b.best[thread + k * b.threads] = b.g_weights[thread + k * b.threads]


@ti.func
def squared_gradient(thread, b: ti.template()):
    """Each thread's part of the squared norm of the gradient."""
    s = ti.cast(0, b.robot.simd.real)
    for k in range(stride_count(b.robot.n.weights, thread, b.threads)):
        i = thread + k * b.threads
        g = b.g_weights[i]
        s += update_gain(b, i) * g * g
    b.shared.partial[thread] = s


@ti.func
def update_gain(b: ti.template(), i):
    bias = i >= b.robot.n.bias and i < b.robot.n.w2
    return ti.select(bias, b.launch.rule.bias_gain, ti.cast(1, b.robot.simd.real))


@ti.func
def use_gradient(thread, b: ti.template()):
    """An update or, without iterations, the gradient as the result. A loss whose gradient overflows does not
    count."""
    i = loss_index(b)
    if thread == 0:
        b.launch.growth[i] = largest_gradient(b) * b.robot.n.masses
    if total(b, 0) < MAX_SQUARE:
        if b.launch.settings.iterations > 0:
            keep_best(thread, b, b.launch.losses[i])
            update_weights(thread, b)
        else:
            write_gradient(thread, b)
    elif thread == 0:
        b.launch.losses[i] = ti.math.inf
        b.launch.status[b.at.robot] = NO_GRADIENT


@ti.func
def largest_gradient(b: ti.template()):
    """The greatest gradient of a position in the reverse sweep."""
    largest, cells = ti.cast(0, b.robot.simd.real), b.robot.n.cell_rows
    for k in range(cells):
        largest = ti.max(largest, b.carry[LARGEST_GRADIENT * cells + k])
    return largest


@ti.func
def update_weights(thread, b: ti.template()):
    """A step against the gradient, always of the same length (paper, Sect. Learning)."""
    rule = ti.static(b.launch.rule)
    step = rule.length / (ti.sqrt(total(b, 0)) + rule.min_gradient)
    for k in range(stride_count(b.robot.n.weights, thread, b.threads)):
        i = thread + k * b.threads
        b.weights[i] = b.weights[i] - step * update_gain(b, i) * b.g_weights[i]


@ti.func
def update(thread, block: ti.template()):
    """The gradient of the weights and, with iterations, one update."""
    whole = ti.static(block.at_step(0))
    block.phase(input_weight_gradients, thread, whole)
    block.phase(motor_weight_gradients, thread, whole)
    block.phase(squared_gradient, thread, block)
    block.phase(sum_partial, thread, block)
    block.phase(use_gradient, thread, block)

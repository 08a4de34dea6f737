"""Transposed weights, the weights' gradient as a matrix product over all steps, and the update."""

from types import SimpleNamespace

from eldir.controller import HIDDEN
from eldir.engine.compiler import ti
from eldir.engine.device.layout import WARP
from eldir.engine.kernels.layout import CPG_ROWS
from eldir.engine.kernels.memory import local

_ROWS, _UNITS = 8, 4
"""Weights of one thread while it adds up their gradients: so many inputs times so many hidden units."""
_ACROSS = HIDDEN // _UNITS
"""Threads side by side for all hidden units."""
_TILE = WARP // _ACROSS * _ROWS
"""Inputs of 32 threads together."""
_AT_ONCE = 2
"""Steps whose numbers a thread loads before it multiplies them."""


def functions(kind: SimpleNamespace, threads: int, phase: object, ahead: SimpleNamespace) -> SimpleNamespace:
    """`ahead` are the functions of the forward pass."""
    real = kind.real
    groups = threads // WARP

    @ti.func
    def transpose_weights(thread, b: ti.template()):
        """Transposed copies of W1, by mass, and of W2, by motor: no sum runs across threads."""
        n = ti.static(b.n)
        first, stride = CPG_ROWS * HIDDEN, (n.inputs - CPG_ROWS) // 4
        for k in range(ahead.rounds(n.bias - first, thread, threads)):
            e = thread + k * threads
            i, h = e // HIDDEN, e % HIDDEN
            b.transposed[first + (4 * h + i % 4) * stride + i // 4] = b.weights[first + e]
        for k in range(ahead.rounds(n.b2 - n.w2, thread, threads)):
            e = thread + k * threads
            b.transposed[n.w2 + e % HIDDEN * n.padded_motors + e // HIDDEN] = b.weights[n.w2 + e]

    @ti.func
    def transpose(own, block: ti.template(), at: ti.template()):
        phase(transpose_weights, own, block)

    @ti.func
    def add_products(
        thread, b: ti.template(), rows: ti.template(), count, columns: ti.template(), out: ti.template()
    ):
        """out[i, h] = sum_t rows[t][i] columns[t][h] for i < count: 32 x 32 for each group of threads."""
        group, lane = thread // WARP, thread % WARP
        steps, stride = b.launch.settings.steps, b.n.step_values
        for k in range(ahead.rounds((count + _TILE - 1) // _TILE, group, groups)):
            row = _TILE * (group + k * groups) + _ROWS * (lane // _ACROSS)
            unit = _UNITS * (lane % _ACROSS)
            sums = ti.static([local(ti.cast(0, real)) for _ in range(_ROWS * _UNITS)])
            if row < count:
                for t in range(steps // _AT_ONCE):
                    for j in ti.static(range(_AT_ONCE)):
                        add_one(rows, row, columns, unit, (_AT_ONCE * t + j) * stride, sums)
                for t in range(steps // _AT_ONCE * _AT_ONCE, steps):
                    add_one(rows, row, columns, unit, t * stride, sums)
                for i in ti.static(range(_ROWS)):
                    if row + i < count:
                        for j in ti.static(range(_UNITS)):
                            out[HIDDEN * (row + i) + unit + j] = sums[_UNITS * i + j]

    @ti.func
    def add_one(rows: ti.template(), row, columns: ti.template(), unit, at, sums: ti.template()):
        x = ti.static([local(rows[at + row + i]) for i in range(_ROWS)])
        d = ti.static([local(columns[at + unit + j]) for j in range(_UNITS)])
        for i in ti.static(range(_ROWS)):
            for j in ti.static(range(_UNITS)):
                sums[_UNITS * i + j] += x[i] * d[j]

    @ti.func
    def add_inputs(thread, b: ti.template()):
        """The gradients of W1 and, as the weights of an input 1, of b1."""
        add_products(thread, b, b.history.inputs, b.n.inputs + 1, b.history.hidden_delta, b.g_weights)

    @ti.func
    def add_motors(thread, b: ti.template()):
        n = ti.static(b.n)
        add_products(thread, b, b.history.action, n.padded_motors, b.history.hidden, b.g_weights + n.w2)
        for k in range(ahead.rounds(n.padded_motors, thread, threads)):
            motor = thread + k * threads
            s = ti.cast(0, real)
            for t in range(b.launch.settings.steps):
                s += b.history.action[t * n.step_values + motor]
            b.g_weights[n.b2 + motor] = s

    @ti.func
    def keep(thread, b: ti.template()):
        for k in range(ahead.rounds(b.n.weights, thread, threads)):
            b.best[thread + k * threads] = b.g_weights[thread + k * threads]

    @ti.func
    def square(thread, b: ti.template()):
        s = ti.cast(0, real)
        for k in range(ahead.rounds(b.n.weights, thread, threads)):
            i = thread + k * threads
            g = b.g_weights[i]
            s += gain(b, i) * g * g
        b.shared.partial[thread] = s

    @ti.func
    def gain(b: ti.template(), i):
        bias = i >= b.n.bias and i < b.n.w2
        return ti.select(bias, b.launch.rule.bias_gain, ti.cast(1, real))

    @ti.func
    def move(thread, b: ti.template()):
        """Against the gradient, always by the same length (paper, Sect. Learning)."""
        rule = ti.static(b.launch.rule)
        step = rule.length / (ti.sqrt(ahead.total(b.shared.sums, 0)) + rule.least_gradient)
        for k in range(ahead.rounds(b.n.weights, thread, threads)):
            i = thread + k * threads
            b.weights[i] = b.weights[i] - step * gain(b, i) * b.g_weights[i]

    @ti.func
    def update(own, block: ti.template(), at: ti.template()):
        whole = ti.static(at(block, 0))
        phase(add_inputs, own, whole)
        phase(add_motors, own, whole)
        if block.launch.settings.iterations > 0:
            phase(square, own, block)
            phase(ahead.sum_partial, own, block)
            phase(move, own, block)
        else:
            phase(keep, own, block)

    return SimpleNamespace(transpose=transpose, update=update)

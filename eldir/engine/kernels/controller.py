"""The neural controller, forward and adjoint (paper, Sect. Neural control)."""

from types import SimpleNamespace

from eldir.engine.compiler import ti
from eldir.engine.kernels import layout
from eldir.engine.kernels.processor import has_wide_registers
from eldir.engine.kernels.tanh import tanh_of


def functions(kind: SimpleNamespace) -> SimpleNamespace:
    """Forward and adjoint for one precision. The 32 hidden units are what vectors run over."""
    lanes, row, tanh = kind.lanes, kind.row, tanh_of(kind.real)
    several = has_wide_registers()  # sums at a time

    @ti.func
    def squash(column: ti.template(), blocks):
        """tanh in place, of blocks of 32 values."""
        for b in range(blocks):
            column.row[b] = tanh(column.row[b])

    @ti.func
    def combine(weights: ti.template(), x: ti.template(), count):
        """sum_i weights.row[i] x[i] over `count` rows, four at a time (padding is 0), in one sum or four."""
        a, b, c, d = row(0.0), row(0.0), row(0.0), row(0.0)
        for four in range((count + 3) >> 2):
            i = 4 * four
            a += weights.row[i] * x.each[i]
            if ti.static(several):
                b += weights.row[i + 1] * x.each[i + 1]
                c += weights.row[i + 2] * x.each[i + 2]
                d += weights.row[i + 3] * x.each[i + 3]
            else:
                for j in ti.static(range(1, 4)):
                    a += weights.row[i + j] * x.each[i + j]
        return (a + b) + (c + d)

    @ti.func
    def combine_sensed(weights: ti.template(), x: ti.template(), body: ti.template()):
        """The same over what is sensed of the masses, x, y, vx, vy of each."""
        a, b, c, d = row(0.0), row(0.0), row(0.0), row(0.0)
        cells = body.n.cells
        for m in range(body.n.masses):
            i, k = 4 * m, body.cell.each[m]
            a += weights.row[i] * x.each[k]
            if ti.static(several):
                b += weights.row[i + 1] * x.each[k + cells]
                c += weights.row[i + 2] * x.each[k + 2 * cells]
                d += weights.row[i + 3] * x.each[k + 3 * cells]
            else:
                for j in ti.static(range(1, 4)):
                    a += weights.row[i + j] * x.each[k + j * cells]
        return (a + b) + (c + d)

    @ti.func
    def transpose(matrix: ti.template(), i, out: ti.template(), j):
        """Row i becomes column j of a matrix that lies in blocks of 32 columns."""
        block, column = j >> 5, j & 31
        for h in range(32):
            out.each[(32 * block + h) * 32 + column] = matrix.each[32 * i + h]

    @ti.func
    def prepare(body: ti.template(), law: ti.template(), brain: ti.template(), work: ti.template()):
        """Transposed copies of the weights, so that no sum runs across a vector."""
        for m in range(body.n.padded_motors):
            transpose(brain.w2, m, work.w2_transposed, m)
        if law.listening:
            for i in range(32 * body.n.mass_blocks):
                work.w1_transposed.row[i] = row(0.0)
            for i in range(4 * body.n.masses):
                transpose(brain.w1, i, work.w1_transposed, i)

    @ti.func
    def sense(
        now: ti.template(), before: ti.template(), body: ti.template(), law: ti.template(), t,
        inputs: ti.template(),
    ):  # fmt: skip
        """The pattern generators; displacement of every mass from the centre of mass, and velocity."""
        nm = body.n.cell_rows
        inputs[4 * nm] = body.cpgs[t]
        if law.listening:
            sense_masses(now, before, body, law, inputs)

    @ti.func
    def sense_masses(
        now: ti.template(), before: ti.template(), body: ti.template(), law: ti.template(),
        inputs: ti.template(),
    ):  # fmt: skip
        sx, sy = lanes(0.0), lanes(0.0)
        for i in range(body.n.cell_rows):
            sx += now.x[i]
            sy += now.y[i]
        cx, cy = sx.sum() * body.per_mass, sy.sum() * body.per_mass
        nm = body.n.cell_rows
        for i in range(nm):
            scale = law.sense * body.mask[i]
            inputs[i] = (now.x[i] - cx - body.reference[i]) * scale
            inputs[nm + i] = (now.y[i] - cy - body.reference[nm + i]) * scale
            vx, vy = now.vx[i], now.vy[i]
            if ti.static(law.staggered):  # half a step later, as positions are
                vx += 0.5 * (vx - before.vx[i])
                vy += 0.5 * (vy - before.vy[i])
            inputs[2 * nm + i] = vx * scale
            inputs[3 * nm + i] = vy * scale

    @ti.func
    def act(
        now: ti.template(), before: ti.template(), body: ti.template(), law: ti.template(),
        brain: ti.template(), t, work: ti.template(),
    ):  # fmt: skip
        """h = tanh(W1 u + b1), a = tanh(W2 h + b2)."""
        sense(now, before, body, law, t, work.inputs)
        hidden = brain.b1.row[0] + combine(brain.cpgs, work.inputs + 4 * body.n.cells, 12)
        if law.listening:
            hidden += combine_sensed(brain.w1, work.inputs, body)
        now.hidden.row[0] = hidden
        squash(now.hidden, 1)
        for b in range(body.n.motor_blocks):
            now.action.row[b] = brain.b2.row[b] + combine(work.w2_transposed + 1024 * b, now.hidden, 32)
        squash(now.action, body.n.motor_blocks)

    @ti.func
    def begin_adjoint(body: ti.template(), work: ti.template()):
        """Clears what later steps have sensed."""
        kind.fill(work.g_sensed, 4 * body.n.cell_rows, 0.0)

    @ti.func
    def act_adjoint(
        now: ti.template(), before: ti.template(), body: ti.template(), law: ti.template(),
        brain: ti.template(), t, work: ti.template(), kept,
    ):  # fmt: skip
        """Propagates the deltas of the actions to the gradients of x and v; keeps what the weights' gradients
        need."""
        hidden_delta = ti.static(work.hidden_deltas + 32 * kept)
        h = now.hidden.row[0]
        g_hidden = combine(brain.w2, work.action_deltas + kept * body.n.padded_motors, body.n.motors)
        hidden_delta.row[0] = g_hidden * (1.0 - h * h)
        if law.listening:
            sense_adjoint(hidden_delta, body, law, t, work)
        sense(now, before, body, law, t, work.chunk_inputs + kept * body.n.kept_inputs)

    @ti.func
    def sense_adjoint(
        hidden_delta: ti.template(), body: ti.template(), law: ti.template(), t, work: ti.template()
    ):
        """Propagates the hidden units' deltas to the gradients of x and v."""
        g, sensed = ti.static(work.g, work.g_sensed)
        if ti.static(law.staggered):  # the step after this one has sensed these velocities too
            for i in range(body.n.cell_rows):
                g.vx[i] = g.vx[i] - 0.5 * law.sense * kind.fourth(sensed, i, 2)
                g.vy[i] = g.vy[i] - 0.5 * law.sense * kind.fourth(sensed, i, 3)
        for b in range(body.n.mass_blocks):
            work.g_inputs.row[b] = combine(work.w1_transposed + 1024 * b, hidden_delta, 32)
        for m in range(body.n.masses):
            sensed.quad[body.cell.each[m]] = work.g_inputs.quad[m]
        sense_v = law.sense
        if ti.static(law.staggered):
            sense_v *= ti.select(t > 0, 1.5, 1.0)
        sx, sy = lanes(0.0), lanes(0.0)
        for i in range(body.n.cell_rows):
            gx, gy = kind.fourth(sensed, i, 0), kind.fourth(sensed, i, 1)
            sx += gx
            sy += gy
            g.x[i] = g.x[i] + law.sense * gx
            g.y[i] = g.y[i] + law.sense * gy
            g.vx[i] = g.vx[i] + sense_v * kind.fourth(sensed, i, 2)
            g.vy[i] = g.vy[i] + sense_v * kind.fourth(sensed, i, 3)
        cx, cy = sx.sum() * body.per_mass * law.sense, sy.sum() * body.per_mass * law.sense
        for i in range(body.n.cell_rows):
            g.x[i] = g.x[i] - cx * body.mask[i]
            g.y[i] = g.y[i] - cy * body.mask[i]

    @ti.func
    def add_outer(
        x: ti.template(), x_stride, rows: ti.template(), row_stride, steps, out: ti.template(), count
    ):
        """out.row[i] += sum_t x[t][i] rows[t] for i < count, eight at a time."""
        for block in range((count + 7) >> 3):
            o = 8 * block
            add_eight(x, x_stride, (o, o + 1, o + 2, o + 3, o + 4, o + 5, o + 6, o + 7),
                      rows, row_stride, steps, out + 32 * o)  # fmt: skip

    @ti.func
    def add_outer_sensed(
        x: ti.template(), rows: ti.template(), steps, body: ti.template(), out: ti.template()
    ):
        """The same of what was sensed of the masses, x, y, vx, vy of each, two masses at a time."""
        n = ti.static(body.n)
        c = n.cells
        for pair in range(n.mass_pairs):
            j, k = body.cell.each[2 * pair], body.cell.each[2 * pair + 1]
            add_eight(x, n.kept_inputs, (j, j + c, j + 2 * c, j + 3 * c, k, k + c, k + 2 * c, k + 3 * c),
                      rows, 1, steps, out + 256 * pair)  # fmt: skip

    @ti.func
    def add_eight(
        x: ti.template(), x_stride, i: ti.template(), rows: ti.template(), row_stride, steps,
        out: ti.template(),
    ):  # fmt: skip
        """out.row[k] += sum_t x[t][i[k]] rows[t] for eight k, all at once or one after the other."""
        if ti.static(several):
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
            for j in ti.static(range(8)):
                s = out.row[j]
                for t in range(steps):
                    s += rows.row[t * row_stride] * x.each[t * x_stride + i[j]]
                out.row[j] = s

    @ti.func
    def add_chunk(
        latest: ti.template(), stride, body: ti.template(), law: ti.template(), work: ti.template(), steps
    ):
        """Adds the weight gradients of some steps, `latest` first, whose deltas and inputs were kept."""
        n, g = ti.static(body.n, work.g_weights)
        deltas, inputs = ti.static(work.hidden_deltas, work.chunk_inputs)
        add_outer(inputs + 4 * n.cells, n.kept_inputs, deltas, 1, steps, g.cpgs, layout.CPG_ROWS)
        if law.listening:
            add_outer_sensed(inputs, deltas, steps, body, g.w1)
        add_outer(work.action_deltas, n.padded_motors, latest.hidden, -(stride >> 5), steps, g.w2, n.motors)
        for t in range(steps):
            g.b1.row[0] = g.b1.row[0] + deltas.row[t]
            for b in range(n.motor_blocks):
                g.b2.row[b] = g.b2.row[b] + work.action_deltas.row[t * n.motor_blocks + b]

    return SimpleNamespace(
        prepare=prepare, squash=squash, act=act,
        begin_adjoint=begin_adjoint, act_adjoint=act_adjoint, add_chunk=add_chunk,
    )  # fmt: skip

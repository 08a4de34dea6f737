"""The neural controller: senses, acts, and passes gradients back (paper, Sect. Neural control)."""

from types import SimpleNamespace

import taichi as ti


def functions(kind: SimpleNamespace) -> SimpleNamespace:
    """Forward and adjoint for one precision. The 32 hidden units are what vectors run over."""
    real, lanes, row = kind.real, kind.lanes, kind.row

    @ti.func
    def rational_tanh(x):
        """To 1e-7."""
        z = ti.min(ti.max(x, -7.9053111), 7.9053111)
        q = z * z
        p = q * -2.76076847742355e-16 + 2.00018790482477e-13
        p = p * q - 8.60467152213735e-11
        p = p * q + 5.12229709037114e-08
        p = p * q + 1.48572235717979e-05
        p = p * q + 6.37261928875436e-04
        p = p * q + 4.89352455891786e-03
        d = q * 1.19825839466702e-06 + 1.18534705686654e-04
        d = d * q + 2.26843463243900e-03
        d = d * q + 4.89352518554385e-03
        return z * p / d

    @ti.func
    def squash(column: ti.template(), blocks):
        """tanh in place, of blocks of 32 values; the true one in float64."""
        if ti.static(real == ti.f32):
            for b in range(blocks):
                column.row[b] = rational_tanh(column.row[b])
        else:
            for k in range(32 * blocks):
                column.each[k] = ti.tanh(column.each[k])

    @ti.func
    def combine(weights: ti.template(), x: ti.template(), count):
        """sum_i weights.row[i] x[i] over `count` rows, four at a time: padding is 0."""
        a, b, c, d = row(0.0), row(0.0), row(0.0), row(0.0)
        for four in range((count + 3) >> 2):
            i = 4 * four
            a += weights.row[i] * x.each[i]
            b += weights.row[i + 1] * x.each[i + 1]
            c += weights.row[i + 2] * x.each[i + 2]
            d += weights.row[i + 3] * x.each[i + 3]
        return (a + b) + (c + d)

    @ti.func
    def transpose(matrix: ti.template(), blocks, out: ti.template()):
        """Blocks of 32 rows of 32, each turned."""
        for b in range(blocks):
            for i in range(32):
                for j in range(32):
                    out.each[(32 * b + i) * 32 + j] = matrix.each[(32 * b + j) * 32 + i]

    @ti.func
    def prepare(body: ti.template(), brain: ti.template(), work: ti.template()):
        """Turned copies of the weights, so that no sum ever runs across a vector."""
        transpose(brain.w2, body.n.motor_blocks, work.w2_transposed)
        transpose(brain.w1, body.n.mass_rows * 2, work.w1_transposed)

    @ti.func
    def sense(
        now: ti.template(), before: ti.template(), body: ti.template(), law: ti.template(), t,
        inputs: ti.template(),
    ):  # fmt: skip
        """Displacement of every mass from the centre of mass, velocity, and the pattern generators."""
        sx, sy = lanes(0.0), lanes(0.0)
        for i in range(body.n.mass_rows):
            sx += now.x[i]
            sy += now.y[i]
        cx, cy = sx.sum() * body.per_mass, sy.sum() * body.per_mass
        nm = body.n.mass_rows
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
        inputs[4 * nm] = body.cpgs[t]

    @ti.func
    def act(
        now: ti.template(), before: ti.template(), body: ti.template(), law: ti.template(),
        brain: ti.template(), t, work: ti.template(),
    ):  # fmt: skip
        """h = tanh(W1 u + b1), a = tanh(W2 h + b2)."""
        sense(now, before, body, law, t, work.inputs)
        mp = body.n.padded_masses
        hidden = brain.b1.row[0] + combine(brain.w1 + 32 * 4 * mp, work.inputs + 4 * mp, 12)
        for channel in range(4):
            first = channel * mp
            hidden += combine(brain.w1 + 32 * first, work.inputs + first, body.n.masses)
        now.hidden.row[0] = hidden
        squash(now.hidden, 1)
        for b in range(body.n.motor_blocks):
            now.action.row[b] = brain.b2.row[b] + combine(work.w2_transposed + 1024 * b, now.hidden, 32)
        squash(now.action, body.n.motor_blocks)

    @ti.func
    def begin_adjoint(body: ti.template(), work: ti.template()):
        """No later step has sensed anything yet."""
        for i in range(4 * body.n.mass_rows):
            work.g_inputs[i] = lanes(0.0)

    @ti.func
    def act_adjoint(
        now: ti.template(), before: ti.template(), body: ti.template(), law: ti.template(),
        brain: ti.template(), t, work: ti.template(), kept,
    ):  # fmt: skip
        """From the deltas of the actions to the gradients of x and v; keeps what weights need."""
        g, g_inputs = ti.static(work.g, work.g_inputs)
        if ti.static(law.staggered):  # the step after this one has sensed these velocities too
            for i in range(body.n.mass_rows):
                half = 0.5 * law.sense * body.mask[i]
                g.vx[i] = g.vx[i] - half * g_inputs[2 * body.n.mass_rows + i]
                g.vy[i] = g.vy[i] - half * g_inputs[3 * body.n.mass_rows + i]
        hidden_delta = ti.static(work.hidden_deltas + 32 * kept)
        h = now.hidden.row[0]
        g_hidden = combine(brain.w2, work.action_deltas + kept * body.n.padded_motors, body.n.motors)
        hidden_delta.row[0] = g_hidden * (1.0 - h * h)
        for b in range(body.n.mass_rows * 2):
            g_inputs.row[b] = combine(work.w1_transposed + 1024 * b, hidden_delta, 32)
        nm = body.n.mass_rows
        sx, sy = lanes(0.0), lanes(0.0)
        for i in range(nm):
            sx += g_inputs[i] * body.mask[i]
            sy += g_inputs[nm + i] * body.mask[i]
        cx, cy = sx.sum() * body.per_mass, sy.sum() * body.per_mass
        for i in range(nm):
            scale = law.sense * body.mask[i]
            g.x[i] = g.x[i] + scale * (g_inputs[i] - cx)
            g.y[i] = g.y[i] + scale * (g_inputs[nm + i] - cy)
            if ti.static(law.staggered):
                scale *= ti.select(t > 0, 1.5, 1.0)
            g.vx[i] = g.vx[i] + scale * g_inputs[2 * nm + i]
            g.vy[i] = g.vy[i] + scale * g_inputs[3 * nm + i]
        sense(now, before, body, law, t, work.chunk_inputs + kept * body.n.inputs)

    @ti.func
    def add_outer(
        x: ti.template(), x_stride, rows: ti.template(), row_stride, steps, out: ti.template(), count
    ):
        """out.row[i] += sum_t x[t][i] rows[t] for i < count, eight at a time."""
        for block in range((count + 7) >> 3):
            o = 8 * block
            s0, s1, s2, s3 = out.row[o], out.row[o + 1], out.row[o + 2], out.row[o + 3]
            s4, s5, s6, s7 = out.row[o + 4], out.row[o + 5], out.row[o + 6], out.row[o + 7]
            for t in range(steps):
                d = rows.row[t * row_stride]
                k = t * x_stride + o
                s0 += d * x.each[k]
                s1 += d * x.each[k + 1]
                s2 += d * x.each[k + 2]
                s3 += d * x.each[k + 3]
                s4 += d * x.each[k + 4]
                s5 += d * x.each[k + 5]
                s6 += d * x.each[k + 6]
                s7 += d * x.each[k + 7]
            out.row[o], out.row[o + 1], out.row[o + 2], out.row[o + 3] = s0, s1, s2, s3
            out.row[o + 4], out.row[o + 5], out.row[o + 6], out.row[o + 7] = s4, s5, s6, s7

    @ti.func
    def add_chunk(latest: ti.template(), stride, body: ti.template(), work: ti.template(), steps):
        """Weight gradients of some steps, `latest` first, whose deltas and inputs were kept."""
        n, g = ti.static(body.n, work.g_weights)
        deltas, inputs = ti.static(work.hidden_deltas, work.chunk_inputs)
        for channel in range(4):
            first = channel * n.padded_masses
            add_outer(inputs + first, n.inputs, deltas, 1, steps, g.w1 + 32 * first, n.masses)
        first = 4 * n.padded_masses
        add_outer(inputs + first, n.inputs, deltas, 1, steps, g.w1 + 32 * first, 16)
        add_outer(work.action_deltas, n.padded_motors, latest.hidden, -(stride >> 5), steps, g.w2, n.motors)
        for t in range(steps):
            g.b1.row[0] = g.b1.row[0] + deltas.row[t]
            for b in range(n.motor_blocks):
                g.b2.row[b] = g.b2.row[b] + work.action_deltas.row[t * n.motor_blocks + b]

    return SimpleNamespace(
        prepare=prepare, act=act, begin_adjoint=begin_adjoint, act_adjoint=act_adjoint, add_chunk=add_chunk
    )

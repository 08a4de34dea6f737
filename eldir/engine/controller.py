"""The perceptron's arithmetic: weighted sums of 32 lanes, tanh, and sums of outer products."""

from types import SimpleNamespace

from eldir.engine.runtime import start

ti = start()


def functions(real, v32):
    """The functions for one precision."""

    @ti.func
    def tanh32(x):
        """A rational function in float32 (error below 1e-7); float64 goes through `tanh_row`."""
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
    def tanh_rows(ws: ti.template(), wv: ti.template(), row, rows):
        """tanh, in place, of `rows` rows of 32 values from row `row`."""
        if ti.static(real == ti.f32):
            for i in range(row, row + rows):
                wv[i] = tanh32(wv[i])
        else:
            for i in range(32 * row, 32 * (row + rows)):
                ws[i] = ti.tanh(ws[i])

    @ti.func
    def combine(weights: ti.template(), row, x: ti.template(), first, count):
        """sum_i weights[row + i] x[first + i] over `count` rows (a multiple of 4)."""
        a, b, c, d = v32(0.0), v32(0.0), v32(0.0), v32(0.0)
        for j in range(count // 4):
            i = 4 * j
            a += weights[row + i] * x[first + i]
            b += weights[row + i + 1] * x[first + i + 1]
            c += weights[row + i + 2] * x[first + i + 2]
            d += weights[row + i + 3] * x[first + i + 3]
        return (a + b) + (c + d)

    @ti.func
    def transpose(p: ti.template(), row, ws: ti.template(), out, blocks):
        """Rows of 32 hidden units to blocks of 32 rows: out[b][h][j] = p[row + 32 b + j][h]."""
        for b in range(blocks):
            for h in range(32):
                for j in range(32):
                    ws[out + (32 * b + h) * 32 + j] = p[(row + 32 * b + j) * 32 + h]

    @ti.func
    def add_outer(
        u: ti.template(),
        first,
        u_step,
        deltas: ti.template(),
        row,
        row_step,
        steps,
        g: ti.template(),
        out,
        count,
    ):
        """g[out + i] += sum_t u[first + t u_step + i] deltas[row + t row_step], i < count (of 8)."""
        for block in range(count // 8):
            o = out + 8 * block
            g0, g1, g2, g3 = g[o], g[o + 1], g[o + 2], g[o + 3]
            g4, g5, g6, g7 = g[o + 4], g[o + 5], g[o + 6], g[o + 7]
            for t in range(steps):
                d = deltas[row + t * row_step]
                k = first + 8 * block + t * u_step
                g0 += d * u[k]
                g1 += d * u[k + 1]
                g2 += d * u[k + 2]
                g3 += d * u[k + 3]
                g4 += d * u[k + 4]
                g5 += d * u[k + 5]
                g6 += d * u[k + 6]
                g7 += d * u[k + 7]
            g[o], g[o + 1], g[o + 2], g[o + 3] = g0, g1, g2, g3
            g[o + 4], g[o + 5], g[o + 6], g[o + 7] = g4, g5, g6, g7

    return SimpleNamespace(tanh_rows=tanh_rows, combine=combine, transpose=transpose, add_outer=add_outer)

"""The kernel: a queue of robots over workers, each robot simulated, differentiated and taught in one go.

Everything a worker touches lies in its own workspace, so results do not depend on the number of
threads. Names are those of the equations: x, y, vx, vy the state before a step, wx, wy the velocity
before contact, h and a the activations, (dx, dy) a spring's vector; a leading g is a gradient.
"""

from functools import cache
from types import SimpleNamespace

from eldir.engine import contact, controller
from eldir.engine.runtime import start

ti = start()

CHUNK = 50
"""Steps whose weight gradients are summed as one matrix product."""
CPG_ROWS = 16
"""The ten central pattern generators, padded."""


@cache
def build(precision: str) -> SimpleNamespace:
    """The kernel for 'f32' or 'f64'."""
    real = ti.f32 if precision == "f32" else ti.f64
    v2, v16, v32 = (ti.types.vector(n, real) for n in (2, 16, 32))
    scalars, ints = ti.types.ndarray(dtype=real, ndim=1), ti.types.ndarray(dtype=ti.i32, ndim=1)
    pairs, lanes, rows = (ti.types.ndarray(dtype=v, ndim=1) for v in (v2, v16, v32))
    brain = controller.functions(real, v32)
    ground_ = contact.functions(real, v2)

    @ti.func
    def up(n, multiple):
        return (n + multiple - 1) // multiple * multiple

    @ti.func
    def even(a, b):
        return v16([a[0], a[2], a[4], a[6], a[8], a[10], a[12], a[14],
                    b[0], b[2], b[4], b[6], b[8], b[10], b[12], b[14]])  # fmt: skip

    @ti.func
    def odd(a, b):
        return v16([a[1], a[3], a[5], a[7], a[9], a[11], a[13], a[15],
                    b[1], b[3], b[5], b[7], b[9], b[11], b[13], b[15]])  # fmt: skip

    @ti.func
    def difference(ws: ti.template(), base, sa: ti.template(), sb: ti.template(), k):
        """Values at the ends a minus those at the ends b, of 16 springs."""
        return v16([ws[base + sa[k + j]] for j in ti.static(range(16))]) - v16(
            [ws[base + sb[k + j]] for j in ti.static(range(16))]
        )

    @ti.kernel
    def run(
        robots: ti.i32, workers: ti.i32, steps: ti.i32, iterations: ti.i32, workspace: ti.i32,
        dt: real, decay: real, fall: real, qk: real, actuation: real, sense: real, softening: real,
        ground_level: real, resting: real, tiny: real, least_gradient: real, update: real, bias_gain: real,
        BACKWARD: ti.template(), FRICTION: ti.template(), RECORD: ti.template(),
        segments: ti.i32, top: real, ground: scalars, cpg: lanes,
        queue: ints, m_: ints, s_: ints, a_: ints, mass_at: ints, spring_at: ints, weight_at: ints,
        record_at: ints, start_: lanes, reference: lanes, mask: lanes, sa: ints, sb: ints, rest: lanes,
        p: scalars, pv: rows, pw: lanes, best: rows, ws: scalars, wv: rows, ww: lanes, w2: pairs,
        losses: scalars, status: ints, record: lanes,
    ):  # fmt: skip
        ti.loop_config(block_dim=1)
        for worker in range(workers):
            zero, one = v16(0.0), v16(1.0)
            zero32, one32 = v32(0.0), v32(1.0)
            while True:
                r = ti.atomic_add(queue[0], 1)
                if r >= robots:
                    break
                M, S, A = m_[r], s_[r], a_[r]
                Mp, Sp, Ap = up(M, 16), up(S, 16), up(A, 32)
                nm, ns = Mp // 16, Sp // 16
                inverse_m = ti.cast(1, real) / M
                inputs = 4 * Mp + ti.static(CPG_ROWS)
                # Parameters: W1 (inputs rows), b1 (1), W2 (Ap rows), b2 (Ap values).
                W1 = weight_at[r] // 32
                b1 = W1 + inputs
                W2 = b1 + 1
                b2 = W2 + Ap
                weight_rows = inputs + 1 + Ap + Ap // 32
                # History of a step: x y vx vy wx wy (Mp each), h (32), a (Ap), dx dy (Sp each).
                stride = 6 * Mp + 32 + Ap + 2 * Sp
                base = worker * workspace
                o = base + stride * (steps + 1)
                u = o
                o += 4 * Mp + 32
                W1t = o
                o += 32 * 4 * Mp
                W2t = o
                o += 32 * Ap
                D1 = o
                o += ti.static(CHUNK) * 32
                D2 = o
                o += ti.static(CHUNK) * Ap
                U = o
                unext = 4 * Mp + 32
                o += ti.static(CHUNK) * unext
                fx = o
                o += Sp
                fy = o
                o += Sp
                J = o  # impulses, pairs (x, y)
                o += 2 * Mp
                gx = o
                o += 6 * Mp
                gy, gvx, gvy, gwx, gwy = gx + Mp, gx + 2 * Mp, gx + 3 * Mp, gx + 4 * Mp, gx + 5 * Mp
                gu = up(o, 32)
                o = gu + 4 * Mp
                G = up(o, 32)
                x0 = mass_at[r] // 8  # two channels a robot, in rows of 16
                k0 = mass_at[r] // 16
                s0 = spring_at[r]
                least = ti.cast(0, real)
                blown = -1
                for it in range(iterations + 1):
                    # ------------------------------------------------------------ forward
                    if A > 0:
                        brain.transpose(p, W2, ws, W2t, Ap // 32)
                    for i in range(nm):
                        ww[base // 16 + i] = start_[x0 + i]
                        ww[base // 16 + nm + i] = start_[x0 + nm + i]
                        ww[base // 16 + 2 * nm + i] = zero
                        ww[base // 16 + 3 * nm + i] = zero
                    ww[(u + 4 * Mp) // 16 + 1] = zero
                    for t in range(steps):
                        z = base + t * stride
                        z16, n16 = z // 16, (z + stride) // 16
                        h = z + 6 * Mp
                        a = h + 32
                        if A > 0:
                            cx, cy = ti.cast(0, real), ti.cast(0, real)
                            for i in range(nm):
                                cx += (ww[z16 + i] * mask[k0 + i]).sum()
                                cy += (ww[z16 + nm + i] * mask[k0 + i]).sum()
                            cx *= inverse_m
                            cy *= inverse_m
                            for i in range(nm):
                                m = mask[k0 + i] * sense
                                ww[u // 16 + i] = (ww[z16 + i] - cx - reference[x0 + i]) * m
                                ww[u // 16 + nm + i] = (ww[z16 + nm + i] - cy - reference[x0 + nm + i]) * m
                                ww[u // 16 + 2 * nm + i] = ww[z16 + 2 * nm + i] * m
                                ww[u // 16 + 3 * nm + i] = ww[z16 + 3 * nm + i] * m
                            ww[u // 16 + 4 * nm] = cpg[t]
                            hidden = pv[b1] + brain.combine(pv, W1 + 4 * Mp, ws, u + 4 * Mp, 12)
                            for c in range(4):
                                hidden += brain.combine(pv, W1 + c * Mp, ws, u + c * Mp, up(M, 4))
                            wv[h // 32] = hidden
                            brain.tanh_rows(ws, wv, h // 32, 1)
                            for b in range(Ap // 32):
                                wv[a // 32 + b] = pv[b2 + b] + brain.combine(
                                    wv, W2t // 32 + 32 * b, ws, h, 32
                                )
                            brain.tanh_rows(ws, wv, a // 32, Ap // 32)
                        # Springs: J = dt k (l - target) / l d, Hooke's law.
                        for i in range(2 * nm):
                            ww[J // 16 + i] = zero
                        for b in range(ns):
                            k = s0 + 16 * b
                            dx = difference(ws, z, sa, sb, k)
                            dy = difference(ws, z + Mp, sa, sb, k)
                            ww[(a + Ap) // 16 + b] = dx
                            ww[(a + Ap + Sp) // 16 + b] = dy
                            length = ti.sqrt(dx * dx + dy * dy) + softening
                            target = rest[k // 16]
                            if 16 * b < A:
                                target *= one + actuation * ww[a // 16 + b]
                            strength = qk * (one - target / length)
                            ww[fx // 16 + b] = strength * dx
                            ww[fy // 16 + b] = strength * dy
                        for k in range(S):
                            f = v2([ws[fx + k], ws[fy + k]])
                            ia, ib = J // 2 + sa[s0 + k], J // 2 + sb[s0 + k]
                            w2[ia] = w2[ia] - f
                            w2[ib] = w2[ib] + f
                        # Masses: damping, gravity, impulses, then contact.
                        speed = zero
                        for i in range(nm):
                            j0, j1 = ww[J // 16 + 2 * i], ww[J // 16 + 2 * i + 1]
                            wx = decay * ww[z16 + 2 * nm + i] + even(j0, j1)
                            wy = decay * ww[z16 + 3 * nm + i] + odd(j0, j1) + fall * mask[k0 + i]
                            speed = ti.max(speed, ti.max(ti.max(wx, zero - wx), ti.max(wy, zero - wy)))
                            ww[z16 + 4 * nm + i] = wx
                            ww[z16 + 5 * nm + i] = wy
                            if ti.static(not FRICTION):
                                y = ww[z16 + nm + i]
                                hit = ti.select(
                                    y + dt * wy < ground_level,
                                    ti.select(wy < -resting, one, zero),
                                    zero,
                                )
                                toi = ti.select(hit > 0.5, (ground_level - y) / ti.min(wy, -resting), v16(dt))
                                ww[n16 + i] = ww[z16 + i] + toi * wx
                                ww[n16 + nm + i] = y + toi * wy
                                ww[n16 + 2 * nm + i] = wx * (one - hit)
                                ww[n16 + 3 * nm + i] = wy * (one - hit)
                        if ti.static(FRICTION):
                            zn = z + stride
                            for i in range(Mp):
                                x = v2([ws[z + i], ws[z + Mp + i]])
                                w = v2([ws[z + 4 * Mp + i], ws[z + 5 * Mp + i]])
                                xn, vn = ground_.friction(ground, segments, top, x, w, dt, tiny)
                                ws[zn + i] = xn[0]
                                ws[zn + Mp + i] = xn[1]
                                ws[zn + 2 * Mp + i] = vn[0]
                                ws[zn + 3 * Mp + i] = vn[1]
                        if not (speed.sum() < 1e6):
                            blown = t
                            break
                    if blown >= 0:
                        break
                    loss = ti.cast(0, real)
                    end = (base + steps * stride) // 16
                    for i in range(nm):
                        loss -= ((ww[end + i] - start_[x0 + i]) * mask[k0 + i]).sum()
                    loss *= inverse_m
                    losses[r * (iterations + 1) + it] = loss
                    if it == 0 or loss < least:
                        least = loss
                        if ti.static(BACKWARD):
                            if iterations > 0:
                                for i in range(weight_rows):
                                    best[W1 + i] = pv[W1 + i]
                    if ti.static(BACKWARD):
                        if A > 0 and (it < iterations or iterations == 0):
                            # ------------------------------------------------------- backward
                            brain.transpose(p, W1, ws, W1t, 4 * Mp // 32)
                            for i in range(weight_rows):
                                wv[G // 32 + i] = zero32
                            for i in range(nm):
                                ww[gx // 16 + i] = -inverse_m * mask[k0 + i]
                                for c in range(1, 4):
                                    ww[gx // 16 + c * nm + i] = zero
                            pending = 0
                            for back in range(steps):
                                t = steps - 1 - back
                                z = base + t * stride
                                z16 = z // 16
                                h = z + 6 * Mp
                                a = h + 32
                                if ti.static(FRICTION):
                                    for i in range(Mp):
                                        x = v2([ws[z + i], ws[z + Mp + i]])
                                        w = v2([ws[z + 4 * Mp + i], ws[z + 5 * Mp + i]])
                                        gp = v2([ws[gx + i], ws[gy + i]])
                                        gv = v2([ws[gvx + i], ws[gvy + i]])
                                        gxy, gw = ground_.friction_adjoint(
                                            ground, segments, top, x, w, dt, tiny, gp, gv
                                        )
                                        ws[gx + i] = gxy[0]
                                        ws[gy + i] = gxy[1]
                                        ws[gwx + i] = gw[0]
                                        ws[gwy + i] = gw[1]
                                for i in range(nm):
                                    if ti.static(not FRICTION):
                                        y = ww[z16 + nm + i]
                                        wx, wy = ww[z16 + 4 * nm + i], ww[z16 + 5 * nm + i]
                                        hit = ti.select(
                                            y + dt * wy < ground_level,
                                            ti.select(wy < -resting, one, zero),
                                            zero,
                                        )
                                        per_w = ti.select(hit > 0.5, one / ti.min(wy, -resting), zero)
                                        toi = ti.select(hit > 0.5, (ground_level - y) * per_w, v16(dt))
                                        px, py = ww[gx // 16 + i], ww[gy // 16 + i]
                                        gtoi = (px * wx + py * wy) * per_w  # d toi = -(dy + toi dwy) / wy
                                        ww[gwx // 16 + i] = px * toi + ww[gvx // 16 + i] * (one - hit)
                                        ww[gwy // 16 + i] = (
                                            py * toi + ww[gvy // 16 + i] * (one - hit) - gtoi * toi
                                        )
                                        ww[gy // 16 + i] = py - gtoi
                                    ww[gvx // 16 + i] = decay * ww[gwx // 16 + i]
                                    ww[gvy // 16 + i] = decay * ww[gwy // 16 + i]
                                    ww[J // 16 + 2 * i] = zero
                                    ww[J // 16 + 2 * i + 1] = zero
                                d2 = D2 + pending * Ap
                                for b in range(Ap // 16):
                                    ww[d2 // 16 + b] = zero
                                for b in range(ns):
                                    k = s0 + 16 * b
                                    dx, dy = ww[(a + Ap) // 16 + b], ww[(a + Ap + Sp) // 16 + b]
                                    # The impulse is -J on a and +J on b.
                                    gjx = difference(ws, gwx, sb, sa, k)
                                    gjy = difference(ws, gwy, sb, sa, k)
                                    plain = ti.sqrt(dx * dx + dy * dy)
                                    per_l = one / (plain + softening)
                                    along = gjx * dx + gjy * dy
                                    target = rest[k // 16]
                                    if 16 * b < A:
                                        act = ww[a // 16 + b]
                                        ww[d2 // 16 + b] = (
                                            -qk * actuation * along * per_l * target * (one - act * act)
                                        )
                                        target *= one + actuation * act
                                    strength = qk * (one - target * per_l)
                                    stretch = along * qk * target * per_l * per_l / ti.max(plain, tiny)
                                    ww[fx // 16 + b] = strength * gjx + stretch * dx
                                    ww[fy // 16 + b] = strength * gjy + stretch * dy
                                for k in range(A, up(A, 16)):
                                    ws[d2 + k] = 0  # springs that share a row with active ones
                                for k in range(S):
                                    f = v2([ws[fx + k], ws[fy + k]])
                                    ia, ib = J // 2 + sa[s0 + k], J // 2 + sb[s0 + k]
                                    w2[ia] = w2[ia] + f
                                    w2[ib] = w2[ib] - f
                                for i in range(nm):
                                    j0, j1 = ww[J // 16 + 2 * i], ww[J // 16 + 2 * i + 1]
                                    ww[gx // 16 + i] = ww[gx // 16 + i] + even(j0, j1)
                                    ww[gy // 16 + i] = ww[gy // 16 + i] + odd(j0, j1)
                                # Controller: back through both layers to the sensed state.
                                hidden = wv[h // 32]
                                d1 = D1 + pending * 32
                                wv[d1 // 32] = brain.combine(pv, W2, ws, d2, up(A, 4)) * (
                                    one32 - hidden * hidden
                                )
                                for b in range(4 * Mp // 32):
                                    wv[gu // 32 + b] = brain.combine(wv, W1t // 32 + 32 * b, ws, d1, 32)
                                cx, cy = ti.cast(0, real), ti.cast(0, real)
                                sx, sy = ti.cast(0, real), ti.cast(0, real)
                                for i in range(nm):
                                    cx += (ww[z16 + i] * mask[k0 + i]).sum()
                                    cy += (ww[z16 + nm + i] * mask[k0 + i]).sum()
                                    sx += (ww[gu // 16 + i] * mask[k0 + i]).sum()
                                    sy += (ww[gu // 16 + nm + i] * mask[k0 + i]).sum()
                                cx *= inverse_m
                                cy *= inverse_m
                                sx *= inverse_m
                                sy *= inverse_m
                                ub = (U + pending * unext) // 16
                                for i in range(nm):
                                    m = mask[k0 + i] * sense
                                    ww[gx // 16 + i] = ww[gx // 16 + i] + m * (ww[gu // 16 + i] - sx)
                                    ww[gy // 16 + i] = ww[gy // 16 + i] + m * (ww[gu // 16 + nm + i] - sy)
                                    ww[gvx // 16 + i] = ww[gvx // 16 + i] + m * ww[gu // 16 + 2 * nm + i]
                                    ww[gvy // 16 + i] = ww[gvy // 16 + i] + m * ww[gu // 16 + 3 * nm + i]
                                    ww[ub + i] = (ww[z16 + i] - cx - reference[x0 + i]) * m
                                    ww[ub + nm + i] = (ww[z16 + nm + i] - cy - reference[x0 + nm + i]) * m
                                    ww[ub + 2 * nm + i] = ww[z16 + 2 * nm + i] * m
                                    ww[ub + 3 * nm + i] = ww[z16 + 3 * nm + i] * m
                                ww[ub + 4 * nm] = cpg[t]
                                pending += 1
                                if pending == ti.static(CHUNK) or t == 0:
                                    for c in range(4):
                                        brain.add_outer(
                                            ws, U + c * Mp, unext, wv, D1 // 32, 1, pending,
                                            wv, G // 32 + c * Mp, up(M, 8),
                                        )  # fmt: skip
                                    brain.add_outer(
                                        ws, U + 4 * Mp, unext, wv, D1 // 32, 1, pending,
                                        wv, G // 32 + 4 * Mp, 16,
                                    )  # fmt: skip
                                    last = (h + (pending - 1) * stride) // 32  # of the chunk's latest step
                                    brain.add_outer(
                                        ws, D2, Ap, wv, last, -(stride // 32), pending,
                                        wv, G // 32 + inputs + 1, up(A, 8),
                                    )  # fmt: skip
                                    for j in range(pending):
                                        wv[G // 32 + inputs] = wv[G // 32 + inputs] + wv[D1 // 32 + j]
                                        for b in range(Ap // 32):
                                            row = G // 32 + inputs + 1 + Ap + b
                                            wv[row] = wv[row] + wv[D2 // 32 + j * (Ap // 32) + b]
                                    pending = 0
                            if iterations == 0:
                                for i in range(weight_rows):
                                    best[W1 + i] = wv[G // 32 + i]  # the gradient is what was asked for
                            else:
                                # Every update has the same length (paper, Sect. Learning).
                                square = ti.cast(0, real)
                                for i in range(weight_rows):
                                    row = wv[G // 32 + i]
                                    square += (row * row).sum()
                                bias = wv[G // 32 + inputs]
                                square += (bias_gain - 1) * (bias * bias).sum()
                                scale = update / (ti.sqrt(square) + least_gradient)
                                for i in range(weight_rows):
                                    pv[W1 + i] = pv[W1 + i] - scale * wv[G // 32 + i]
                                pv[b1] = pv[b1] - (bias_gain - 1) * scale * bias
                status[r] = blown
                if ti.static(RECORD):
                    # Copied as it lies: x y vx vy (4 Mp) and a (Ap) of every state.
                    width = (4 * Mp + Ap) // 16
                    for t in range(steps + 1):
                        z16 = (base + t * stride) // 16
                        q = record_at[r] + t * width
                        for i in range(4 * nm):
                            record[q + i] = ww[z16 + i]
                        for i in range(Ap // 16):
                            record[q + 4 * nm + i] = ww[z16 + 6 * nm + 2 + i]

    return SimpleNamespace(run=run)

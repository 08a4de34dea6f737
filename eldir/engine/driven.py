"""The built robot: masses in grams, strips that buckle, Coulomb friction, prescribed free lengths.

The same queue of robots over workers as in `kernel.py`, forward only and without a history, for
horizons of a million steps. float64 throughout: a step moves a mass by less than float32 can tell.
"""

from functools import cache

from eldir.engine.runtime import start

ti = start()

PROPERTIES = 8
"""Scalars of a robot: dt, gravity dt, drag factor, friction, and padding."""


@cache
def build():
    """The kernel."""
    real = ti.f64
    v2, v16 = ti.types.vector(2, real), ti.types.vector(16, real)
    scalars, ints = ti.types.ndarray(dtype=real, ndim=1), ti.types.ndarray(dtype=ti.i32, ndim=1)
    pairs, lanes = ti.types.ndarray(dtype=v2, ndim=1), ti.types.ndarray(dtype=v16, ndim=1)

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
    def gather(values: ti.template(), base, index: ti.template(), k):
        return v16([values[base + index[k + j]] for j in ti.static(range(16))])

    @ti.kernel
    def run(
        robots: ti.i32, workers: ti.i32, workspace: ti.i32, every: ti.i32,
        queue: ints, m_: ints, s_: ints, a_: ints, intervals_: ints, substeps_: ints, properties: scalars,
        mass_at: ints, spring_at: ints, length_at: ints, record_at: ints,
        state: scalars, state16: lanes, per_mass: lanes, sa: ints, sb: ints,
        rest16: lanes, stiffness16: lanes, buckling16: lanes, damping16: lanes,
        lengths: scalars, stiffnesses: scalars,
        ws: scalars, ww: lanes, w2: pairs, status: ints, record: lanes,
    ):  # fmt: skip
        ti.loop_config(block_dim=1)
        for worker in range(workers):
            zero, one = v16(0.0), v16(1.0)
            while True:
                r = ti.atomic_add(queue[0], 1)
                if r >= robots:
                    break
                M, S, A = m_[r], s_[r], a_[r]
                Mp, Sp = up(M, 16), up(S, 16)
                nm, ns = Mp // 16, Sp // 16
                n = substeps_[r]
                dt, fall = properties[8 * r], properties[8 * r + 1]
                decay, mu = properties[8 * r + 2], properties[8 * r + 3]
                z = 4 * mass_at[r]  # x y vx vy, Mp each, kept in place
                z16 = z // 16
                k0 = spring_at[r]
                rest = worker * workspace
                stiff = rest + Sp
                fx, fy = stiff + Sp, stiff + 2 * Sp
                J = fy + Sp
                for b in range(ns):
                    ww[rest // 16 + b] = rest16[k0 // 16 + b]
                    ww[stiff // 16 + b] = stiffness16[k0 // 16 + b]
                blown = -1
                for i in range(nm):
                    for c in range(2):
                        record[record_at[r] + c * nm + i] = state16[z16 + c * nm + i]
                for interval in range(intervals_[r]):
                    q = length_at[r] + interval * A
                    for step in range(n):
                        # Free lengths of the active springs, linear between the given instants.
                        part = ti.cast(step + 1, real) / n
                        for k in range(A):
                            ws[rest + k] = lengths[q + k] + part * (lengths[q + A + k] - lengths[q + k])
                            ws[stiff + k] = stiffnesses[q + k] + part * (
                                stiffnesses[q + A + k] - stiffnesses[q + k]
                            )
                        for i in range(2 * nm):
                            ww[J // 16 + i] = zero
                        for b in range(ns):
                            k = k0 + 16 * b
                            dx = gather(state, z, sa, k) - gather(state, z, sb, k)
                            dy = gather(state, z + Mp, sa, k) - gather(state, z + Mp, sb, k)
                            ux = gather(state, z + 2 * Mp, sa, k) - gather(state, z + 2 * Mp, sb, k)
                            uy = gather(state, z + 3 * Mp, sa, k) - gather(state, z + 3 * Mp, sb, k)
                            length = ti.sqrt(dx * dx + dy * dy) + 1e-12
                            free = ww[rest // 16 + b]
                            stretch = length - free
                            # A strip in compression carries its buckling load, a little more as it bends.
                            bent = buckling16[k // 16] * ti.min(stretch / (free + free) - one, zero)
                            force = ti.max(ww[stiff // 16 + b] * stretch, bent)
                            force = force + damping16[k // 16] * (ux * dx + uy * dy) / length
                            pull = dt * force / length
                            ww[fx // 16 + b] = pull * dx
                            ww[fy // 16 + b] = pull * dy
                        for k in range(S):
                            f = v2([ws[fx + k], ws[fy + k]])
                            ia, ib = J // 2 + sa[k0 + k], J // 2 + sb[k0 + k]
                            w2[ia] = w2[ia] - f
                            w2[ib] = w2[ib] + f
                        for i in range(nm):
                            j0, j1 = ww[J // 16 + 2 * i], ww[J // 16 + 2 * i + 1]
                            w = per_mass[mass_at[r] // 16 + i]  # 1/m, and 0 where there is no mass
                            there = ti.min(w * 1e9, one)
                            y = state16[z16 + nm + i]
                            vx = decay * state16[z16 + 2 * nm + i] + even(j0, j1) * w
                            vy = decay * state16[z16 + 3 * nm + i] + odd(j0, j1) * w + fall * there
                            # Coulomb: the ground stops the fall within the step, and what slides by at
                            # most mu times the change that this took.
                            push = ti.max((zero - y) / dt - vy, zero)
                            vy = vy + push
                            grip = mu * push
                            vx = vx - ti.max(ti.min(vx, grip), zero - grip)
                            state16[z16 + i] = state16[z16 + i] + dt * vx
                            state16[z16 + nm + i] = y + dt * vy
                            state16[z16 + 2 * nm + i] = vx
                            state16[z16 + 3 * nm + i] = vy
                    speed = zero
                    for i in range(2 * nm):
                        v = state16[z16 + 2 * nm + i]
                        speed = ti.max(speed, ti.max(v, zero - v))
                    if not (speed.sum() < 1e4):
                        blown = interval
                        break
                    if (interval + 1) % every == 0:
                        o = record_at[r] + (interval + 1) // every * 2 * nm
                        for i in range(2 * nm):
                            record[o + i] = state16[z16 + i]
                status[r] = blown

    return run

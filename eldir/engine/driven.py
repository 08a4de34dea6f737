"""The built robot: masses in grams, strips that buckle and may be clamped, Coulomb friction, prescribed
free lengths.

Groups of up to eight robots with the same springs, such as one design in all its phases, move side by side:
each has one lane of every vector, so that nothing is gathered, scattered or summed across lanes, and no
robot knows of its neighbours. Groups are taken from the same kind of queue as in `kernel.py`. Forward
only and without a history, for horizons of a million steps; float64 throughout: a step moves a mass by less
than float32 can tell.
"""

from functools import cache

from eldir.engine.runtime import start

ti = start()

LANES = 8
PROPERTIES = 6
"""Vectors of a group: dt, gravity dt, drag factor, friction, steps in an interval, bending damping [s]."""


@cache
def build(clamped: bool):
    """The kernel; without `clamped` strips the hexagons do not turn."""
    real = ti.f64
    lane = ti.types.vector(LANES, real)
    lanes, ints = ti.types.ndarray(dtype=lane, ndim=1), ti.types.ndarray(dtype=ti.i32, ndim=1)
    scalars = ti.types.ndarray(dtype=real, ndim=1)
    rows = 7 if clamped else 4
    forces = 3 if clamped else 2

    @ti.func
    def angle(sine, cosine):
        """Of a unit vector, in (-pi, pi): four times the arc tangent of a quarter angle's tangent, by its
        series, right to 1e-12 up to a right angle."""
        half = sine / (lane(1.0 + 1e-15) + cosine)
        t = half / (lane(1.0) + ti.sqrt(lane(1.0) + half * half))
        q = t * t
        series = lane(1.0 / 27)
        for n in ti.static(range(25, 0, -2)):
            series = lane(1.0 / n) - q * series
        return 4.0 * t * series

    @ti.kernel
    def run(
        groups: ti.i32, workers: ti.i32, workspace: ti.i32, every: ti.i32,
        queue: ints, m_: ints, s_: ints, a_: ints, intervals_: ints, substeps_: ints, properties: lanes,
        mass_at: ints, spring_at: ints, length_at: ints, record_at: ints,
        state: lanes, per_mass: lanes, per_inertia: lanes, ends: ints, direction: scalars,
        rest: lanes, stiffness: lanes, buckling: lanes, damping: lanes, bending: lanes,
        lengths: lanes, stiffnesses: lanes,
        impulse: lanes, status: ints, record: lanes,
    ):  # fmt: skip
        ti.loop_config(block_dim=1)
        for worker in range(workers):
            zero, one = lane(0.0), lane(1.0)
            while True:
                g = ti.atomic_add(queue[0], 1)
                if g >= groups:
                    break
                M, S, A = m_[g], s_[g], a_[g]
                dt, fall = properties[PROPERTIES * g], properties[PROPERTIES * g + 1]
                decay, mu = properties[PROPERTIES * g + 2], properties[PROPERTIES * g + 3]
                steps, slow = properties[PROPERTIES * g + 4], properties[PROPERTIES * g + 5]
                x = rows * mass_at[g]  # x, y, vx, vy and, clamped, cosine, sine, spin; M each, kept in place
                y, vx, vy = x + M, x + 2 * M, x + 3 * M
                turn = x + 4 * M
                i0, k0 = mass_at[g], spring_at[g]
                jx = worker * workspace
                jy = jx + M
                jt = jx + 2 * M
                for i in range(forces * M):
                    impulse[jx + i] = zero
                for i in range(2 * M):
                    record[record_at[g] + i] = state[x + i]
                blown = zero - one
                for interval in range(intervals_[g]):
                    q = length_at[g] + interval * A
                    for step in range(substeps_[g]):
                        # A robot with fewer steps in an interval than its neighbours waits at its end.
                        going = lane(ti.cast(step, real)) < steps
                        part = ti.min(lane(step + 1.0) / steps, one)
                        for k in range(S):
                            s = k0 + k
                            a, b = ends[2 * s], ends[2 * s + 1]
                            dx, dy = state[x + a] - state[x + b], state[y + a] - state[y + b]
                            ux, uy = state[vx + a] - state[vx + b], state[vy + a] - state[vy + b]
                            length = ti.sqrt(dx * dx + dy * dy) + 1e-12  # never divides by 0
                            per_length = one / length
                            free, force = rest[s], zero
                            if k < A:  # the free length is linear between the given instants
                                free = lengths[q + k] + part * (lengths[q + A + k] - lengths[q + k])
                                force = stiffnesses[q + k] + part * (
                                    stiffnesses[q + A + k] - stiffnesses[q + k]
                                )
                                force = force * (length - free)
                            else:
                                # A strip in compression carries its buckling load, and a little more as
                                # it bends.
                                stretch = length - free
                                bent = buckling[s] * ti.min(0.5 * stretch / free - one, zero)
                                force = ti.max(stiffness[s] * stretch, bent)
                            force = force + damping[s] * (ux * dx + uy * dy) * per_length
                            pull = dt * force * per_length
                            fx, fy = pull * dx, pull * dy
                            if ti.static(clamped):
                                if k >= A:
                                    # Slope-deflection of a beam that turns with its chord, of direction
                                    # (nx, ny): end moments k (4 pa + 2 pb), k (2 pa + 4 pb) for end
                                    # rotations pa, pb from the chord, and the couple that balances them.
                                    nx, ny = dx * per_length, dy * per_length
                                    ex, ey = direction[2 * s], direction[2 * s + 1]
                                    ca, sa = state[turn + a], state[turn + M + a]
                                    cb, sb = state[turn + b], state[turn + M + b]
                                    ax, ay = ca * ex - sa * ey, sa * ex + ca * ey
                                    bx, by = cb * ex - sb * ey, sb * ex + cb * ey
                                    spin = (nx * uy - ny * ux) * per_length
                                    pa = angle(nx * ay - ny * ax, nx * ax + ny * ay)
                                    pb = angle(nx * by - ny * bx, nx * bx + ny * by)
                                    pa = pa + slow * (state[turn + 2 * M + a] - spin)
                                    pb = pb + slow * (state[turn + 2 * M + b] - spin)
                                    stiff = 2.0 * dt * bending[s]
                                    ma, mb = stiff * (pa + pa + pb), stiff * (pa + pb + pb)
                                    impulse[jt + a] = impulse[jt + a] - ma
                                    impulse[jt + b] = impulse[jt + b] - mb
                                    couple = (ma + mb) * per_length
                                    fx = fx + couple * ny
                                    fy = fy - couple * nx
                            impulse[jx + a] = impulse[jx + a] - fx
                            impulse[jy + a] = impulse[jy + a] - fy
                            impulse[jx + b] = impulse[jx + b] + fx
                            impulse[jy + b] = impulse[jy + b] + fy
                        for i in range(M):
                            w = per_mass[i0 + i]
                            height = state[y + i]
                            before_x, before_y = state[vx + i], state[vy + i]
                            along = decay * before_x + impulse[jx + i] * w
                            up = decay * before_y + impulse[jy + i] * w + fall
                            # Coulomb: the ground stops the fall within the step, and what slides by at
                            # most mu times the change that this took.
                            push = ti.max(zero - height / dt - up, zero)
                            up = up + push
                            grip = mu * push
                            along = along - ti.max(ti.min(along, grip), zero - grip)
                            state[x + i] = state[x + i] + ti.select(going, dt * along, zero)
                            state[y + i] = height + ti.select(going, dt * up, zero)
                            state[vx + i] = ti.select(going, along, before_x)
                            state[vy + i] = ti.select(going, up, before_y)
                            impulse[jx + i] = zero
                            impulse[jy + i] = zero
                            if ti.static(clamped):
                                spin_before = state[turn + 2 * M + i]
                                spin_ = decay * spin_before + impulse[jt + i] * per_inertia[i0 + i]
                                spin_ = ti.select(going, spin_, spin_before)
                                # Cayley's rotation by dt spin keeps cosine^2 + sine^2 = 1.
                                h = ti.select(going, 0.5 * dt * spin_, zero)
                                c, s_ = state[turn + i], state[turn + M + i]
                                scale = one / (one + h * h)
                                state[turn + i] = ((one - h * h) * c - 2.0 * h * s_) * scale
                                state[turn + M + i] = ((one - h * h) * s_ + 2.0 * h * c) * scale
                                state[turn + 2 * M + i] = spin_
                                impulse[jt + i] = zero
                    fastest = zero
                    for i in range(2 * M):
                        v = state[vx + i]
                        fastest = fastest + v * v
                    sound = 0
                    for j in ti.static(range(LANES)):
                        if blown[j] < 0.0:
                            if fastest[j] < 1e8:
                                sound = 1
                            else:
                                blown[j] = ti.cast(interval, real)
                    if sound == 0:
                        break
                    if (interval + 1) % every == 0:
                        o = record_at[g] + (interval + 1) // every * 2 * M
                        for i in range(2 * M):
                            record[o + i] = state[x + i]
                for j in ti.static(range(LANES)):
                    status[LANES * g + j] = ti.cast(blown[j], ti.i32)

    return run

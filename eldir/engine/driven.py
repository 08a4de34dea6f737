"""The kernel of the built robot: masses in grams, strips, Coulomb friction, prescribed free lengths.

Groups of up to eight robots with the same springs, such as one design in all its phases, move side by side:
each has one lane of every vector, so that nothing is gathered, scattered or summed across lanes, and no
robot knows of its neighbours. Workers take groups from a queue as in `kernel.py`. Forward only and without
a history, for horizons of a million steps; float64 throughout: a step moves a mass by less than float32 can
tell.
"""

from functools import cache

import taichi as ti

from eldir.engine import coulomb, strip

LANES = 8
PROPERTIES = 6
"""Vectors of a group: dt, gravity dt, drag factor, friction, steps in an interval, bending delay [s]."""
BLOWN = 1e8  # sum of squared speeds [m2/s2] beyond which a robot has blown up


@cache
def build(clamped: bool):
    """The kernel; without `clamped` strips the hexagons do not turn."""
    lane = ti.types.vector(LANES, ti.f64)
    lanes, ints = ti.types.ndarray(dtype=lane, ndim=1), ti.types.ndarray(dtype=ti.i32, ndim=1)
    scalars = ti.types.ndarray(dtype=ti.f64, ndim=1)
    rows, forces = (7, 3) if clamped else (4, 2)
    element, ground = strip.functions(lane), coulomb.functions(lane)

    @ti.kernel
    def run(
        groups: ti.i32, workers: ti.i32, workspace: ti.i32, every: ti.i32,
        queue: ints, m_: ints, s_: ints, a_: ints, intervals_: ints, substeps_: ints, properties: lanes,
        mass_at: ints, spring_at: ints, length_at: ints, record_at: ints, ends: ints, direction: scalars,
        state: lanes, per_mass: lanes, per_inertia: lanes,
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
                p = PROPERTIES * g
                dt, fall, decay = properties[p], properties[p + 1], properties[p + 2]
                friction, steps, delay = properties[p + 3], properties[p + 4], properties[p + 5]
                # The state is kept in place, M of each: x, y, vx, vy, and clamped cosine, sine, spin.
                x = rows * mass_at[g]
                y, vx, vy = x + M, x + 2 * M, x + 3 * M
                cosine, sine, spin = x + 4 * M, x + 5 * M, x + 6 * M
                jx = worker * workspace
                jy, jt = jx + M, jx + 2 * M
                for i in range(forces * M):
                    impulse[jx + i] = zero
                for i in range(2 * M):
                    record[record_at[g] + i] = state[x + i]
                blown = zero - one
                for interval in range(intervals_[g]):
                    q = length_at[g] + interval * A
                    for step in range(substeps_[g]):
                        # A robot with fewer steps in an interval than its neighbours waits at its end.
                        going = lane(ti.cast(step, ti.f64)) < steps
                        part = ti.min(lane(step + 1.0) / steps, one)
                        for k in range(S):
                            s = spring_at[g] + k
                            a, b = ends[2 * s], ends[2 * s + 1]
                            dx, dy = state[x + a] - state[x + b], state[y + a] - state[y + b]
                            ux, uy = state[vx + a] - state[vx + b], state[vy + a] - state[vy + b]
                            length = ti.sqrt(dx * dx + dy * dy) + 1e-12  # never divides by 0
                            per_length = one / length
                            nx, ny = dx * per_length, dy * per_length
                            force = damping[s] * (ux * nx + uy * ny)
                            if k < A:  # a shape-memory spring, linear between the given instants
                                free = lengths[q + k] + part * (lengths[q + A + k] - lengths[q + k])
                                stiff = stiffnesses[q + k] + part * (
                                    stiffnesses[q + A + k] - stiffnesses[q + k]
                                )
                                force += stiff * (length - free)
                            else:
                                force += element.tension(length, rest[s], stiffness[s], buckling[s])
                            fx, fy = dt * force * nx, dt * force * ny
                            if ti.static(clamped):
                                if k >= A:
                                    ex, ey = direction[2 * s], direction[2 * s + 1]
                                    pa = element.rotation(nx, ny, state[cosine + a], state[sine + a], ex, ey)
                                    pb = element.rotation(nx, ny, state[cosine + b], state[sine + b], ex, ey)
                                    turning = (nx * uy - ny * ux) * per_length  # of the chord [rad/s]
                                    pa = pa + delay * (state[spin + a] - turning)
                                    pb = pb + delay * (state[spin + b] - turning)
                                    ma, mb = element.moments(dt * bending[s], pa, pb)
                                    impulse[jt + a] = impulse[jt + a] - ma
                                    impulse[jt + b] = impulse[jt + b] - mb
                                    couple = (ma + mb) * per_length  # what balances both moments
                                    fx = fx + couple * ny
                                    fy = fy - couple * nx
                            impulse[jx + a] = impulse[jx + a] - fx
                            impulse[jy + a] = impulse[jy + a] - fy
                            impulse[jx + b] = impulse[jx + b] + fx
                            impulse[jy + b] = impulse[jy + b] + fy
                        for i in range(M):
                            w = per_mass[mass_at[g] + i]
                            before_x, before_y = state[vx + i], state[vy + i]
                            along, up = ground.meet(
                                state[y + i],
                                decay * before_x + impulse[jx + i] * w,
                                decay * before_y + impulse[jy + i] * w + fall,
                                friction,
                                dt,
                            )
                            state[x + i] = state[x + i] + ti.select(going, dt * along, zero)
                            state[y + i] = state[y + i] + ti.select(going, dt * up, zero)
                            state[vx + i] = ti.select(going, along, before_x)
                            state[vy + i] = ti.select(going, up, before_y)
                            impulse[jx + i] = zero
                            impulse[jy + i] = zero
                        if ti.static(clamped):
                            for i in range(M):
                                before = state[spin + i]
                                after = decay * before + impulse[jt + i] * per_inertia[mass_at[g] + i]
                                after = ti.select(going, after, before)
                                # Cayley's rotation by dt spin keeps cosine^2 + sine^2 = 1.
                                h = ti.select(going, 0.5 * dt * after, zero)
                                scale, h2 = one / (one + h * h), h + h
                                c0, s0 = state[cosine + i], state[sine + i]
                                state[cosine + i] = ((one - h * h) * c0 - h2 * s0) * scale
                                state[sine + i] = ((one - h * h) * s0 + h2 * c0) * scale
                                state[spin + i] = after
                                impulse[jt + i] = zero
                    squares = zero
                    for i in range(2 * M):
                        squares = squares + state[vx + i] * state[vx + i]
                    sound = 0
                    for j in ti.static(range(LANES)):
                        if blown[j] < 0.0:
                            if squares[j] < BLOWN:
                                sound = 1
                            else:
                                blown[j] = ti.cast(interval, ti.f64)
                    if sound == 0:
                        break
                    if (interval + 1) % every == 0:
                        o = record_at[g] + (interval + 1) // every * 2 * M
                        for i in range(2 * M):
                            record[o + i] = state[x + i]
                for j in ti.static(range(LANES)):
                    status[LANES * g + j] = ti.cast(blown[j], ti.i32)

    return run

"""The kernels of the built robot: masses in grams, strips, Coulomb friction, prescribed free lengths; with or
without the slope, how the motion changes with one parameter.

Groups of up to eight robots with the same springs, such as one design in all its phases, move side by side:
each has one lane of every vector, so that nothing is gathered, scattered or summed across lanes, and no
robot knows of its neighbours. Workers take groups from a queue as in `kernel.py`. Forward only and without
a history, for horizons of a million steps; float64 throughout: a step moves a mass by less than float32 can
tell.

The slope is forward-mode differentiation by hand, step by step. Every lane then is one robot with one
parameter, so that eight parameters of a robot, or one parameter of eight robots, go side by side. Names
that end in _ are slopes: derivatives with respect to the lane's parameter. The step itself does not depend
on it.
"""

from functools import cache

from eldir.engine.built import coulomb, strip
from eldir.engine.compiler import ti

LANES = 8
PROPERTIES = 6
"""Vectors of a group: dt, gravity dt, drag factor, friction, steps in an interval, bending delay [s]."""
BLOWN = 1e8  # sum of squared speeds [m2/s2] beyond which a robot has blown up


@cache
def build(clamped: bool, sloped: bool):
    """The kernel; without `clamped` strips the hexagons do not turn, and where it is not `sloped`, nothing
    with a _ is looked at."""
    lane = ti.types.vector(LANES, ti.f64)
    lanes, ints = ti.types.ndarray(dtype=lane, ndim=1), ti.types.ndarray(dtype=ti.i32, ndim=1)
    scalars = ti.types.ndarray(dtype=ti.f64, ndim=1)
    rows, forces = (7, 3) if clamped else (4, 2)
    element, ground = strip.functions(lane), coulomb.functions(lane)

    @ti.kernel
    def run(
        groups: ti.i32, workers: ti.i32, workspace: ti.i32, every: ti.i32,
        queue: ints, m_: ints, s_: ints, a_: ints, intervals_: ints, substeps_: ints,
        properties: lanes, properties_: lanes,
        mass_at: ints, spring_at: ints, length_at: ints, record_at: ints, ends: ints, direction: scalars,
        state: lanes, state_: lanes,
        per_mass: lanes, per_mass_: lanes, per_inertia: lanes, per_inertia_: lanes,
        rest: lanes, rest_: lanes, stiffness: lanes, stiffness_: lanes, buckling: lanes, buckling_: lanes,
        damping: lanes, damping_: lanes, bending: lanes, bending_: lanes,
        lengths: lanes, lengths_: lanes, stiffnesses: lanes, stiffnesses_: lanes,
        impulse: lanes, impulse_: lanes, status: ints, record: lanes, record_: lanes,
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
                fall_, decay_ = properties_[p + 1], properties_[p + 2]
                friction_, delay_ = properties_[p + 3], properties_[p + 5]
                # The state is kept in place, M of each: x, y, vx, vy, and clamped cosine, sine, spin.
                x = rows * mass_at[g]
                y, vx, vy = x + M, x + 2 * M, x + 3 * M
                cosine, sine, spin = x + 4 * M, x + 5 * M, x + 6 * M
                jx = worker * workspace
                jy, jt = jx + M, jx + 2 * M
                for i in range(forces * M):
                    impulse[jx + i] = zero
                    if ti.static(sloped):
                        impulse_[jx + i] = zero
                for i in range(2 * M):
                    record[record_at[g] + i] = state[x + i]
                    if ti.static(sloped):
                        record_[record_at[g] + i] = state_[x + i]
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
                            rate = ux * nx + uy * ny
                            force = damping[s] * rate
                            # What several of the blocks below share.
                            ux_, uy_, length_, nx_, ny_ = zero, zero, zero, zero, zero
                            force_, fx_, fy_ = zero, zero, zero
                            if ti.static(sloped):
                                dx_, dy_ = state_[x + a] - state_[x + b], state_[y + a] - state_[y + b]
                                ux_, uy_ = state_[vx + a] - state_[vx + b], state_[vy + a] - state_[vy + b]
                                length_ = nx * dx_ + ny * dy_
                                nx_ = (dx_ - nx * length_) * per_length
                                ny_ = (dy_ - ny * length_) * per_length
                                rate_ = ux_ * nx + ux * nx_ + uy_ * ny + uy * ny_
                                force_ = damping_[s] * rate + damping[s] * rate_
                            if k < A:  # a shape-memory spring, linear between the given instants
                                free = lengths[q + k] + part * (lengths[q + A + k] - lengths[q + k])
                                stiff = stiffnesses[q + k] + part * (
                                    stiffnesses[q + A + k] - stiffnesses[q + k]
                                )
                                force += stiff * (length - free)
                                if ti.static(sloped):
                                    free_ = lengths_[q + k] + part * (lengths_[q + A + k] - lengths_[q + k])
                                    stiff_ = stiffnesses_[q + k] + part * (
                                        stiffnesses_[q + A + k] - stiffnesses_[q + k]
                                    )
                                    force_ += stiff_ * (length - free) + stiff * (length_ - free_)
                            else:
                                force += element.tension(length, rest[s], stiffness[s], buckling[s])
                                if ti.static(sloped):
                                    force_ += element.tension_slope(
                                        length, rest[s], stiffness[s], buckling[s],
                                        length_, rest_[s], stiffness_[s], buckling_[s],
                                    )  # fmt: skip
                            fx, fy = dt * force * nx, dt * force * ny
                            if ti.static(sloped):
                                fx_, fy_ = dt * (force_ * nx + force * nx_), dt * (force_ * ny + force * ny_)
                            if ti.static(clamped):
                                if k >= A:
                                    ex, ey = direction[2 * s], direction[2 * s + 1]
                                    ca, sa, ra = state[cosine + a], state[sine + a], state[spin + a]
                                    cb, sb, rb = state[cosine + b], state[sine + b], state[spin + b]
                                    turning = (nx * uy - ny * ux) * per_length  # of the chord [rad/s]
                                    pa = element.rotation(nx, ny, ca, sa, ex, ey) + delay * (ra - turning)
                                    pb = element.rotation(nx, ny, cb, sb, ex, ey) + delay * (rb - turning)
                                    ma, mb = element.moments(dt * bending[s], pa, pb)
                                    impulse[jt + a] = impulse[jt + a] - ma
                                    impulse[jt + b] = impulse[jt + b] - mb
                                    couple = (ma + mb) * per_length  # what balances both moments
                                    fx = fx + couple * ny
                                    fy = fy - couple * nx
                                    if ti.static(sloped):
                                        ca_, sa_, ra_ = state_[cosine + a], state_[sine + a], state_[spin + a]
                                        cb_, sb_, rb_ = state_[cosine + b], state_[sine + b], state_[spin + b]
                                        turning_ = (
                                            nx_ * uy + nx * uy_ - ny_ * ux - ny * ux_ - turning * length_
                                        ) * per_length
                                        pa_ = element.rotation_slope(nx, ny, ca, sa, nx_, ny_, ca_, sa_)
                                        pb_ = element.rotation_slope(nx, ny, cb, sb, nx_, ny_, cb_, sb_)
                                        pa_ = pa_ + delay_ * (ra - turning) + delay * (ra_ - turning_)
                                        pb_ = pb_ + delay_ * (rb - turning) + delay * (rb_ - turning_)
                                        ma_, mb_ = element.moments(dt * bending[s], pa_, pb_)
                                        ma1, mb1 = element.moments(dt * bending_[s], pa, pb)
                                        ma_, mb_ = ma_ + ma1, mb_ + mb1
                                        impulse_[jt + a] = impulse_[jt + a] - ma_
                                        impulse_[jt + b] = impulse_[jt + b] - mb_
                                        couple_ = (ma_ + mb_ - couple * length_) * per_length
                                        fx_ = fx_ + couple_ * ny + couple * ny_
                                        fy_ = fy_ - couple_ * nx - couple * nx_
                            impulse[jx + a] = impulse[jx + a] - fx
                            impulse[jy + a] = impulse[jy + a] - fy
                            impulse[jx + b] = impulse[jx + b] + fx
                            impulse[jy + b] = impulse[jy + b] + fy
                            if ti.static(sloped):
                                impulse_[jx + a] = impulse_[jx + a] - fx_
                                impulse_[jy + a] = impulse_[jy + a] - fy_
                                impulse_[jx + b] = impulse_[jx + b] + fx_
                                impulse_[jy + b] = impulse_[jy + b] + fy_
                        for i in range(M):
                            w = per_mass[mass_at[g] + i]
                            before_x, before_y = state[vx + i], state[vy + i]
                            wx = decay * before_x + impulse[jx + i] * w
                            wy = decay * before_y + impulse[jy + i] * w + fall
                            along, up = ground.meet(state[y + i], wx, wy, friction, dt)
                            if ti.static(sloped):
                                w_, slope_x, slope_y = (
                                    per_mass_[mass_at[g] + i], state_[vx + i], state_[vy + i],
                                )  # fmt: skip
                                wx_ = decay_ * before_x + decay * slope_x
                                wy_ = decay_ * before_y + decay * slope_y + fall_
                                wx_ = wx_ + impulse_[jx + i] * w + impulse[jx + i] * w_
                                wy_ = wy_ + impulse_[jy + i] * w + impulse[jy + i] * w_
                                along_, up_ = ground.meet_slope(
                                    state[y + i], wx, wy, friction, dt, state_[y + i], wx_, wy_, friction_
                                )
                                state_[x + i] = state_[x + i] + ti.select(going, dt * along_, zero)
                                state_[y + i] = state_[y + i] + ti.select(going, dt * up_, zero)
                                state_[vx + i] = ti.select(going, along_, slope_x)
                                state_[vy + i] = ti.select(going, up_, slope_y)
                                impulse_[jx + i] = zero
                                impulse_[jy + i] = zero
                            state[x + i] = state[x + i] + ti.select(going, dt * along, zero)
                            state[y + i] = state[y + i] + ti.select(going, dt * up, zero)
                            state[vx + i] = ti.select(going, along, before_x)
                            state[vy + i] = ti.select(going, up, before_y)
                            impulse[jx + i] = zero
                            impulse[jy + i] = zero
                        if ti.static(clamped):
                            for i in range(M):
                                before, w = state[spin + i], per_inertia[mass_at[g] + i]
                                after = decay * before + impulse[jt + i] * w
                                after = ti.select(going, after, before)
                                # Cayley's rotation by dt spin keeps cosine^2 + sine^2 = 1.
                                h = ti.select(going, 0.5 * dt * after, zero)
                                scale, h2 = one / (one + h * h), h + h
                                c0, s0 = state[cosine + i], state[sine + i]
                                c1 = ((one - h * h) * c0 - h2 * s0) * scale
                                s1 = ((one - h * h) * s0 + h2 * c0) * scale
                                if ti.static(sloped):
                                    before_, w_ = state_[spin + i], per_inertia_[mass_at[g] + i]
                                    after_ = decay_ * before + decay * before_
                                    after_ = after_ + impulse_[jt + i] * w + impulse[jt + i] * w_
                                    after_ = ti.select(going, after_, before_)
                                    h_ = ti.select(going, 0.5 * dt * after_, zero)
                                    turned_ = 2.0 * h_ * scale  # of the angle 2 atan(h)
                                    c0_, s0_ = state_[cosine + i], state_[sine + i]
                                    c1_ = ((one - h * h) * c0_ - h2 * s0_) * scale - turned_ * s1
                                    s1_ = ((one - h * h) * s0_ + h2 * c0_) * scale + turned_ * c1
                                    state_[cosine + i], state_[sine + i], state_[spin + i] = c1_, s1_, after_
                                    impulse_[jt + i] = zero
                                state[cosine + i], state[sine + i], state[spin + i] = c1, s1, after
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
                            if ti.static(sloped):
                                record_[o + i] = state_[x + i]
                for j in ti.static(range(LANES)):
                    status[LANES * g + j] = ti.cast(blown[j], ti.i32)

    return run

"""The kernel of the built robot together with its slope: how the motion changes with one parameter.

Forward-mode differentiation by hand of `driven.py`, step by step. Every lane is one robot with one
parameter, so that eight parameters of a robot, or one parameter of eight robots, go side by side. Names
that end in _ are slopes: derivatives with respect to the lane's parameter. The step itself does not depend
on it.
"""

from functools import cache

import taichi as ti

from eldir.engine import coulomb, strip
from eldir.engine.driven import BLOWN, LANES, PROPERTIES


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
                x = rows * mass_at[g]
                y, vx, vy = x + M, x + 2 * M, x + 3 * M
                cosine, sine, spin = x + 4 * M, x + 5 * M, x + 6 * M
                jx = worker * workspace
                jy, jt = jx + M, jx + 2 * M
                for i in range(forces * M):
                    impulse[jx + i] = zero
                    impulse_[jx + i] = zero
                for i in range(2 * M):
                    record[record_at[g] + i] = state[x + i]
                    record_[record_at[g] + i] = state_[x + i]
                blown = zero - one
                for interval in range(intervals_[g]):
                    q = length_at[g] + interval * A
                    for step in range(substeps_[g]):
                        going = lane(ti.cast(step, ti.f64)) < steps
                        part = ti.min(lane(step + 1.0) / steps, one)
                        for k in range(S):
                            s = spring_at[g] + k
                            a, b = ends[2 * s], ends[2 * s + 1]
                            dx, dy = state[x + a] - state[x + b], state[y + a] - state[y + b]
                            ux, uy = state[vx + a] - state[vx + b], state[vy + a] - state[vy + b]
                            dx_, dy_ = state_[x + a] - state_[x + b], state_[y + a] - state_[y + b]
                            ux_, uy_ = state_[vx + a] - state_[vx + b], state_[vy + a] - state_[vy + b]
                            length = ti.sqrt(dx * dx + dy * dy) + 1e-12
                            per_length = one / length
                            nx, ny = dx * per_length, dy * per_length
                            length_ = nx * dx_ + ny * dy_
                            nx_, ny_ = (dx_ - nx * length_) * per_length, (dy_ - ny * length_) * per_length
                            rate, rate_ = ux * nx + uy * ny, ux_ * nx + ux * nx_ + uy_ * ny + uy * ny_
                            force, force_ = damping[s] * rate, damping_[s] * rate + damping[s] * rate_
                            if k < A:
                                free = lengths[q + k] + part * (lengths[q + A + k] - lengths[q + k])
                                stiff = stiffnesses[q + k] + part * (
                                    stiffnesses[q + A + k] - stiffnesses[q + k]
                                )
                                free_ = lengths_[q + k] + part * (lengths_[q + A + k] - lengths_[q + k])
                                stiff_ = stiffnesses_[q + k] + part * (
                                    stiffnesses_[q + A + k] - stiffnesses_[q + k]
                                )
                                force += stiff * (length - free)
                                force_ += stiff_ * (length - free) + stiff * (length_ - free_)
                            else:
                                force += element.tension(length, rest[s], stiffness[s], buckling[s])
                                force_ += element.tension_slope(
                                    length, rest[s], stiffness[s], buckling[s],
                                    length_, rest_[s], stiffness_[s], buckling_[s],
                                )  # fmt: skip
                            fx, fy = dt * force * nx, dt * force * ny
                            fx_, fy_ = dt * (force_ * nx + force * nx_), dt * (force_ * ny + force * ny_)
                            if ti.static(clamped):
                                if k >= A:
                                    ex, ey = direction[2 * s], direction[2 * s + 1]
                                    ca, sa, ra = state[cosine + a], state[sine + a], state[spin + a]
                                    cb, sb, rb = state[cosine + b], state[sine + b], state[spin + b]
                                    ca_, sa_, ra_ = state_[cosine + a], state_[sine + a], state_[spin + a]
                                    cb_, sb_, rb_ = state_[cosine + b], state_[sine + b], state_[spin + b]
                                    turning = (nx * uy - ny * ux) * per_length
                                    turning_ = (
                                        nx_ * uy + nx * uy_ - ny_ * ux - ny * ux_ - turning * length_
                                    ) * per_length
                                    pa = element.rotation(nx, ny, ca, sa, ex, ey) + delay * (ra - turning)
                                    pb = element.rotation(nx, ny, cb, sb, ex, ey) + delay * (rb - turning)
                                    pa_ = element.rotation_slope(nx, ny, ca, sa, nx_, ny_, ca_, sa_)
                                    pb_ = element.rotation_slope(nx, ny, cb, sb, nx_, ny_, cb_, sb_)
                                    pa_ = pa_ + delay_ * (ra - turning) + delay * (ra_ - turning_)
                                    pb_ = pb_ + delay_ * (rb - turning) + delay * (rb_ - turning_)
                                    ma, mb = element.moments(dt * bending[s], pa, pb)
                                    ma_, mb_ = element.moments(dt * bending[s], pa_, pb_)
                                    ma1, mb1 = element.moments(dt * bending_[s], pa, pb)
                                    ma_, mb_ = ma_ + ma1, mb_ + mb1
                                    impulse[jt + a] = impulse[jt + a] - ma
                                    impulse[jt + b] = impulse[jt + b] - mb
                                    impulse_[jt + a] = impulse_[jt + a] - ma_
                                    impulse_[jt + b] = impulse_[jt + b] - mb_
                                    couple = (ma + mb) * per_length
                                    couple_ = (ma_ + mb_ - couple * length_) * per_length
                                    fx, fy = fx + couple * ny, fy - couple * nx
                                    fx_ = fx_ + couple_ * ny + couple * ny_
                                    fy_ = fy_ - couple_ * nx - couple * nx_
                            impulse[jx + a] = impulse[jx + a] - fx
                            impulse[jy + a] = impulse[jy + a] - fy
                            impulse[jx + b] = impulse[jx + b] + fx
                            impulse[jy + b] = impulse[jy + b] + fy
                            impulse_[jx + a] = impulse_[jx + a] - fx_
                            impulse_[jy + a] = impulse_[jy + a] - fy_
                            impulse_[jx + b] = impulse_[jx + b] + fx_
                            impulse_[jy + b] = impulse_[jy + b] + fy_
                        for i in range(M):
                            w, w_ = per_mass[mass_at[g] + i], per_mass_[mass_at[g] + i]
                            before_x, before_y = state[vx + i], state[vy + i]
                            slope_x, slope_y = state_[vx + i], state_[vy + i]
                            wx = decay * before_x + impulse[jx + i] * w
                            wy = decay * before_y + impulse[jy + i] * w + fall
                            wx_ = decay_ * before_x + decay * slope_x
                            wy_ = decay_ * before_y + decay * slope_y + fall_
                            wx_ = wx_ + impulse_[jx + i] * w + impulse[jx + i] * w_
                            wy_ = wy_ + impulse_[jy + i] * w + impulse[jy + i] * w_
                            along, up = ground.meet(state[y + i], wx, wy, friction, dt)
                            along_, up_ = ground.meet_slope(
                                state[y + i], wx, wy, friction, dt, state_[y + i], wx_, wy_, friction_
                            )
                            state[x + i] = state[x + i] + ti.select(going, dt * along, zero)
                            state[y + i] = state[y + i] + ti.select(going, dt * up, zero)
                            state_[x + i] = state_[x + i] + ti.select(going, dt * along_, zero)
                            state_[y + i] = state_[y + i] + ti.select(going, dt * up_, zero)
                            state[vx + i] = ti.select(going, along, before_x)
                            state[vy + i] = ti.select(going, up, before_y)
                            state_[vx + i] = ti.select(going, along_, slope_x)
                            state_[vy + i] = ti.select(going, up_, slope_y)
                            impulse[jx + i] = zero
                            impulse[jy + i] = zero
                            impulse_[jx + i] = zero
                            impulse_[jy + i] = zero
                        if ti.static(clamped):
                            for i in range(M):
                                before, before_ = state[spin + i], state_[spin + i]
                                w, w_ = per_inertia[mass_at[g] + i], per_inertia_[mass_at[g] + i]
                                after = decay * before + impulse[jt + i] * w
                                after_ = decay_ * before + decay * before_
                                after_ = after_ + impulse_[jt + i] * w + impulse[jt + i] * w_
                                after = ti.select(going, after, before)
                                after_ = ti.select(going, after_, before_)
                                h = ti.select(going, 0.5 * dt * after, zero)
                                h_ = ti.select(going, 0.5 * dt * after_, zero)
                                scale, h2 = one / (one + h * h), h + h
                                c0, s0 = state[cosine + i], state[sine + i]
                                c0_, s0_ = state_[cosine + i], state_[sine + i]
                                c1 = ((one - h * h) * c0 - h2 * s0) * scale
                                s1 = ((one - h * h) * s0 + h2 * c0) * scale
                                turned_ = 2.0 * h_ * scale  # of the angle 2 atan(h)
                                state[cosine + i] = c1
                                state[sine + i] = s1
                                state_[cosine + i] = ((one - h * h) * c0_ - h2 * s0_) * scale - turned_ * s1
                                state_[sine + i] = ((one - h * h) * s0_ + h2 * c0_) * scale + turned_ * c1
                                state[spin + i] = after
                                state_[spin + i] = after_
                                impulse[jt + i] = zero
                                impulse_[jt + i] = zero
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
                            record_[o + i] = state_[x + i]
                for j in ti.static(range(LANES)):
                    status[LANES * g + j] = ti.cast(blown[j], ti.i32)

    return run

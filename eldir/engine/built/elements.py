"""One step of a group of printed robots: springs, strips, masses and hexagons, each with its slope beside it.

`now` are the values (`GroupArrays`) and `now_` their slopes. Names that end in _ are slopes: derivatives with
respect to the lane's parameter. Without `sloped` nothing with a _ is compiled.
"""

from types import SimpleNamespace
from typing import Any, NamedTuple

from eldir.engine.built import coulomb, strip
from eldir.engine.compiler import ti


class Chord(NamedTuple):
    """From the second to the first mass of a spring; or its slope, without `per_length`."""

    nx: Any
    """Unit vector."""
    ny: Any
    ux: Any
    """Velocity of the first mass relative to the second [m/s]."""
    uy: Any
    length: Any
    """[m]"""
    rate: Any
    """Speed of lengthening [m/s]."""
    per_length: Any = None
    """[1/m]"""


def functions(lane: Any, clamped: bool, sloped: bool) -> SimpleNamespace:
    """The parts of a step for one type of vector. If `clamped`, strips bend and hexagons turn."""
    zero, one = lane(0.0), lane(1.0)
    element, ground = strip.functions(lane), coulomb.functions(lane)

    @ti.func
    def chord(now: ti.template(), a, b):
        dx, dy = now.x[a] - now.x[b], now.y[a] - now.y[b]
        ux, uy = now.vx[a] - now.vx[b], now.vy[a] - now.vy[b]
        length = ti.sqrt(dx * dx + dy * dy) + 1e-12  # never divides by 0
        per_length = one / length
        nx, ny = dx * per_length, dy * per_length
        rate = ux * nx + uy * ny
        return ti.static(Chord(nx, ny, ux, uy, length, rate, per_length))

    @ti.func
    def chord_slope(now_: ti.template(), a, b, c: ti.template()):
        dx_, dy_ = now_.x[a] - now_.x[b], now_.y[a] - now_.y[b]
        ux_, uy_ = now_.vx[a] - now_.vx[b], now_.vy[a] - now_.vy[b]
        length_ = c.nx * dx_ + c.ny * dy_
        nx_ = (dx_ - c.nx * length_) * c.per_length
        ny_ = (dy_ - c.ny * length_) * c.per_length
        rate_ = ux_ * c.nx + c.ux * nx_ + uy_ * c.ny + c.uy * ny_
        return ti.static(Chord(nx_, ny_, ux_, uy_, length_, rate_))

    @ti.func
    def chord_spin(c: ti.template()):
        """[rad/s]"""
        return (c.nx * c.uy - c.ny * c.ux) * c.per_length

    @ti.func
    def chord_spin_slope(c: ti.template(), c_: ti.template(), turning):
        return (
            c_.nx * c.uy + c.nx * c_.uy - c_.ny * c.ux - c.ny * c_.ux - turning * c_.length
        ) * c.per_length

    @ti.func
    def bend(now: ti.template(), c: ti.template(), cosine, sine, spin, ex, ey, turning):
        """Angle of a strip's end from its chord, and what its delay adds to it [rad]."""
        return element.rotation(c.nx, c.ny, cosine, sine, ex, ey) + now.delay * (spin - turning)

    @ti.func
    def delayed_slope(now: ti.template(), now_: ti.template(), turned_, spin, spin_, turning, turning_):
        """Slope of that angle; `turned_` is its slope without the delay."""
        return turned_ + now_.delay * (spin - turning) + now.delay * (spin_ - turning_)

    @ti.func
    def between(table: ti.template(), q, active, part):
        """A shape-memory spring's value, linear between the given instants."""
        return table[q] + part * (table[q + active] - table[q])

    @ti.func
    def add_impulse(now: ti.template(), a, b, fx, fy):
        """Pulls the two masses of a spring towards each other."""
        now.impulse_x[a] = now.impulse_x[a] - fx
        now.impulse_y[a] = now.impulse_y[a] - fy
        now.impulse_x[b] = now.impulse_x[b] + fx
        now.impulse_y[b] = now.impulse_y[b] + fy

    @ti.func
    def add_moments(now: ti.template(), a, b, ma, mb):
        now.moment[a] = now.moment[a] - ma
        now.moment[b] = now.moment[b] - mb

    @ti.func
    def motor_force(group: ti.template(), now: ti.template(), q, part, length):
        """Hooke's law of a shape-memory spring [N]."""
        free = between(now.free_length, q, group.active, part)
        stiff = between(now.spring_rate, q, group.active, part)
        return stiff * (length - free)

    @ti.func
    def motor_force_slope(
        group: ti.template(), now: ti.template(), now_: ti.template(), q, part, length, length_
    ):
        free = between(now.free_length, q, group.active, part)
        stiff = between(now.spring_rate, q, group.active, part)
        free_ = between(now_.free_length, q, group.active, part)
        stiff_ = between(now_.spring_rate, q, group.active, part)
        return stiff_ * (length - free) + stiff * (length_ - free_)

    @ti.func
    def strip_force(now: ti.template(), s, length):
        return element.tension(length, now.rest_length[s], now.stiffness[s], now.buckling[s])

    @ti.func
    def strip_force_slope(now: ti.template(), now_: ti.template(), s, length, length_):
        return element.tension_slope(
            length, now.rest_length[s], now.stiffness[s], now.buckling[s],
            length_, now_.rest_length[s], now_.stiffness[s], now_.buckling[s],
        )  # fmt: skip

    @ti.func
    def pull(group: ti.template(), now: ti.template(), now_: ti.template(), first, part):
        """All springs add their impulses: the shape-memory springs, which come first, and the strips.

        `first` is where the free lengths of the interval's first instant begin; `part` of it has passed.
        """
        for k in range(group.springs):
            s = group.spring_at + k
            a, b = group.ends[2 * s], group.ends[2 * s + 1]
            c = ti.static(chord(now, a, b))
            c_ = ti.static(chord_slope(now_, a, b, c) if sloped else c)
            force, force_ = now.damping[s] * c.rate, lane(0.0)
            if ti.static(sloped):
                force_ = now_.damping[s] * c.rate + now.damping[s] * c_.rate
            if k < group.active:
                force += motor_force(group, now, first + k, part, c.length)
                if ti.static(sloped):
                    force_ += motor_force_slope(group, now, now_, first + k, part, c.length, c_.length)
            else:
                force += strip_force(now, s, c.length)
                if ti.static(sloped):
                    force_ += strip_force_slope(now, now_, s, c.length, c_.length)
            fx, fy = group.dt * force * c.nx, group.dt * force * c.ny
            fx_, fy_ = lane(0.0), lane(0.0)
            if ti.static(sloped):
                fx_ = group.dt * (force_ * c.nx + force * c_.nx)
                fy_ = group.dt * (force_ * c.ny + force * c_.ny)
            if ti.static(clamped):
                if k >= group.active:
                    couple, couple_ = clamp(group, now, now_, s, a, b, c, c_)
                    fx = fx + couple * c.ny
                    fy = fy - couple * c.nx
                    if ti.static(sloped):
                        fx_ = fx_ + couple_ * c.ny + couple * c_.ny
                        fy_ = fy_ - couple_ * c.nx - couple * c_.nx
            add_impulse(now, a, b, fx, fy)
            if ti.static(sloped):
                add_impulse(now_, a, b, fx_, fy_)

    @ti.func
    def clamp(
        group: ti.template(), now: ti.template(), now_: ti.template(), s, a, b,
        c: ti.template(), c_: ti.template(),
    ):  # fmt: skip
        """A strip bends and turns the hexagons at its ends; returns the couple of forces that balances both
        moments, and its slope."""
        ex, ey = group.direction[2 * s], group.direction[2 * s + 1]
        ca, sa, ra = now.cosine[a], now.sine[a], now.spin[a]
        cb, sb, rb = now.cosine[b], now.sine[b], now.spin[b]
        turning = chord_spin(c)
        pa = bend(now, c, ca, sa, ra, ex, ey, turning)
        pb = bend(now, c, cb, sb, rb, ex, ey, turning)
        ma, mb = element.moments(group.dt * now.bending[s], pa, pb)
        add_moments(now, a, b, ma, mb)
        couple = (ma + mb) * c.per_length
        couple_ = lane(0.0)
        if ti.static(sloped):
            ca_, sa_, ra_ = now_.cosine[a], now_.sine[a], now_.spin[a]
            cb_, sb_, rb_ = now_.cosine[b], now_.sine[b], now_.spin[b]
            turning_ = chord_spin_slope(c, c_, turning)
            pa_ = element.rotation_slope(c.nx, c.ny, ca, sa, c_.nx, c_.ny, ca_, sa_)
            pb_ = element.rotation_slope(c.nx, c.ny, cb, sb, c_.nx, c_.ny, cb_, sb_)
            pa_ = delayed_slope(now, now_, pa_, ra, ra_, turning, turning_)
            pb_ = delayed_slope(now, now_, pb_, rb, rb_, turning, turning_)
            ma_, mb_ = moments_slope(group.dt, now.bending[s], now_.bending[s], pa, pb, pa_, pb_)
            add_moments(now_, a, b, ma_, mb_)
            couple_ = (ma_ + mb_ - couple * c_.length) * c.per_length
        return couple, couple_

    @ti.func
    def moments_slope(dt, bending, bending_, pa, pb, pa_, pb_):
        ma, mb = element.moments(dt * bending, pa_, pb_)
        ma1, mb1 = element.moments(dt * bending_, pa, pb)
        return ma + ma1, mb + mb1

    @ti.func
    def move_masses(group: ti.template(), now: ti.template(), now_: ti.template(), going):
        """Semi-implicit Euler with drag, gravity, impulses and the table. Robots not `going` wait."""
        for i in range(group.masses):
            w, before_x, before_y = now.per_mass[i], now.vx[i], now.vy[i]
            wx = now.decay * before_x + now.impulse_x[i] * w
            wy = now.decay * before_y + now.impulse_y[i] * w + now.fall
            along, up = ground.meet(now.y[i], wx, wy, now.friction, group.dt)
            if ti.static(sloped):
                wx_, wy_ = pushed_slope(now, now_, i, before_x, before_y, w)
                along_, up_ = ground.meet_slope(
                    now.y[i], wx, wy, now.friction, group.dt, now_.y[i], wx_, wy_, now_.friction
                )
                place(group, now_, i, now_.vx[i], now_.vy[i], along_, up_, going)
            place(group, now, i, before_x, before_y, along, up, going)

    @ti.func
    def pushed_slope(now: ti.template(), now_: ti.template(), i, before_x, before_y, w):
        """Slopes of the speeds before the table acts."""
        w_, slope_x, slope_y = now_.per_mass[i], now_.vx[i], now_.vy[i]
        wx_ = now_.decay * before_x + now.decay * slope_x
        wy_ = now_.decay * before_y + now.decay * slope_y + now_.fall
        wx_ = wx_ + now_.impulse_x[i] * w + now.impulse_x[i] * w_
        wy_ = wy_ + now_.impulse_y[i] * w + now.impulse_y[i] * w_
        return wx_, wy_

    @ti.func
    def place(group: ti.template(), now: ti.template(), i, before_x, before_y, along, up, going):
        """Moves mass i with its new speeds, or its slopes with theirs, and clears its impulse."""
        now.x[i] = now.x[i] + ti.select(going, group.dt * along, zero)
        now.y[i] = now.y[i] + ti.select(going, group.dt * up, zero)
        now.vx[i] = ti.select(going, along, before_x)
        now.vy[i] = ti.select(going, up, before_y)
        now.impulse_x[i] = zero
        now.impulse_y[i] = zero

    @ti.func
    def turn_hexagons(group: ti.template(), now: ti.template(), now_: ti.template(), going):
        """Cayley's rotation by dt spin, which keeps cosine^2 + sine^2 = 1."""
        for i in range(group.masses):
            before, w = now.spin[i], now.per_inertia[i]
            after = now.decay * before + now.moment[i] * w
            after = ti.select(going, after, before)
            h = ti.select(going, 0.5 * group.dt * after, zero)
            scale, h2 = one / (one + h * h), h + h
            c0, s0 = now.cosine[i], now.sine[i]
            c1 = ((one - h * h) * c0 - h2 * s0) * scale
            s1 = ((one - h * h) * s0 + h2 * c0) * scale
            if ti.static(sloped):
                after_ = spin_slope(now, now_, i, before, w, going)
                h_ = ti.select(going, 0.5 * group.dt * after_, zero)
                turned_ = 2.0 * h_ * scale  # of the angle 2 atan(h)
                c0_, s0_ = now_.cosine[i], now_.sine[i]
                c1_ = ((one - h * h) * c0_ - h2 * s0_) * scale - turned_ * s1
                s1_ = ((one - h * h) * s0_ + h2 * c0_) * scale + turned_ * c1
                now_.cosine[i], now_.sine[i], now_.spin[i] = c1_, s1_, after_
                now_.moment[i] = zero
            now.cosine[i], now.sine[i], now.spin[i] = c1, s1, after
            now.moment[i] = zero

    @ti.func
    def spin_slope(now: ti.template(), now_: ti.template(), i, before, w, going):
        before_, w_ = now_.spin[i], now_.per_inertia[i]
        after_ = now_.decay * before + now.decay * before_
        after_ = after_ + now_.moment[i] * w + now.moment[i] * w_
        return ti.select(going, after_, before_)

    return SimpleNamespace(pull=pull, move_masses=move_masses, turn_hexagons=turn_hexagons)

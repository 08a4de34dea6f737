"""Impulses of the springs and strips of a group of printed robots in one step, each with its slope beside it.

`now` are the values (`GroupArrays`) and `now_` their slopes. Names that end in _ are slopes: derivatives with
respect to the lane's parameter. Without `sloped` nothing with a _ is compiled.
"""

from types import SimpleNamespace
from typing import Any, NamedTuple

from eldir.engine.built import strip
from eldir.engine.compiler import ti


class Chord(NamedTuple):
    """A spring's chord from its second to its first mass; or the chord's slope, without `per_length`."""

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
    """The impulses of all springs, for one type of vector. If `clamped`, strips bend."""
    one = lane(1.0)
    element = strip.functions(lane)

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
        """Angular velocity of the chord [rad/s]."""
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
            if k < group.active:  # a shape-memory spring: Hooke's law
                free = between(now.free_length, first + k, group.active, part)
                stiff = between(now.spring_rate, first + k, group.active, part)
                force += stiff * (c.length - free)
                if ti.static(sloped):
                    free_ = between(now_.free_length, first + k, group.active, part)
                    stiff_ = between(now_.spring_rate, first + k, group.active, part)
                    force_ += stiff_ * (c.length - free) + stiff * (c_.length - free_)
            else:
                rest, stiff, load = now.rest_length[s], now.stiffness[s], now.buckling[s]
                force += element.tension(c.length, rest, stiff, load)
                if ti.static(sloped):
                    force_ += element.tension_slope(
                        c.length, rest, stiff, load,
                        c_.length, now_.rest_length[s], now_.stiffness[s], now_.buckling[s],
                    )  # fmt: skip
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
            ma_, mb_ = element.moments(group.dt * now.bending[s], pa_, pb_)
            ma1, mb1 = element.moments(group.dt * now_.bending[s], pa, pb)
            ma_, mb_ = ma_ + ma1, mb_ + mb1
            add_moments(now_, a, b, ma_, mb_)
            couple_ = (ma_ + mb_ - couple * c_.length) * c.per_length
        return couple, couple_

    return SimpleNamespace(pull=pull)

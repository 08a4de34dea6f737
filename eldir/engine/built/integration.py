"""Motion of the masses and hexagons of a group of printed robots in one step, each with its slope beside it.

`now` are the values (`GroupArrays`) and `now_` their slopes. Names that end in _ are slopes (see `impulses`).
"""

from types import SimpleNamespace
from typing import Any

from eldir.engine.built import coulomb
from eldir.engine.compiler import ti


def functions(lane: Any, sloped: bool) -> SimpleNamespace:
    """Semi-implicit Euler for one type of vector."""
    zero, one = lane(0.0), lane(1.0)
    ground = coulomb.functions(lane)

    @ti.func
    def move_masses(group: ti.template(), now: ti.template(), now_: ti.template(), going):
        """Semi-implicit Euler with drag, gravity, impulses and the table. Robots not `going` wait."""
        for i in range(group.masses):
            w, before_x, before_y = now.per_mass[i], now.vx[i], now.vy[i]
            wx = now.decay * before_x + now.impulse_x[i] * w + now.slide
            wy = now.decay * before_y + now.impulse_y[i] * w + now.fall
            along, up = ground.meet(now.y[i], wx, wy, now.friction[i], group.dt)
            if ti.static(sloped):
                w_, slope_x, slope_y = now_.per_mass[i], now_.vx[i], now_.vy[i]
                wx_ = now_.decay * before_x + now.decay * slope_x + now_.slide
                wy_ = now_.decay * before_y + now.decay * slope_y + now_.fall
                wx_ = wx_ + now_.impulse_x[i] * w + now.impulse_x[i] * w_
                wy_ = wy_ + now_.impulse_y[i] * w + now.impulse_y[i] * w_
                along_, up_ = ground.meet_slope(
                    now.y[i], wx, wy, now.friction[i], group.dt, now_.y[i], wx_, wy_, now_.friction[i]
                )
                place(group, now_, i, slope_x, slope_y, along_, up_, going)
            place(group, now, i, before_x, before_y, along, up, going)

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
                before_, w_ = now_.spin[i], now_.per_inertia[i]
                after_ = now_.decay * before + now.decay * before_
                after_ = after_ + now_.moment[i] * w + now.moment[i] * w_
                after_ = ti.select(going, after_, before_)
                h_ = ti.select(going, 0.5 * group.dt * after_, zero)
                turned_ = 2.0 * h_ * scale  # of the angle 2 atan(h)
                c0_, s0_ = now_.cosine[i], now_.sine[i]
                c1_ = ((one - h * h) * c0_ - h2 * s0_) * scale - turned_ * s1
                s1_ = ((one - h * h) * s0_ + h2 * c0_) * scale + turned_ * c1
                now_.cosine[i], now_.sine[i], now_.spin[i] = c1_, s1_, after_
                now_.moment[i] = zero
            now.cosine[i], now.sine[i], now.spin[i] = c1, s1, after
            now.moment[i] = zero

    return SimpleNamespace(move_masses=move_masses, turn_hexagons=turn_hexagons)

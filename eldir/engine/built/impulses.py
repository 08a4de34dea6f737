"""Impulses of the springs and strips of a group of printed robots in one step. `now` are the group's values
(`GroupArrays`), which are dual numbers where tangents are computed."""

from typing import Any, NamedTuple

from eldir.engine.built.dual import sqrt, variable
from eldir.engine.built.strip import end_moments, end_rotation, interpolate, strip_tension
from eldir.engine.compiler import ti


class Chord(NamedTuple):
    """A spring's chord from its second to its first mass."""

    nx: Any
    """Unit vector."""
    ny: Any
    vx: Any
    """Velocity of the first mass relative to the second [m/s]."""
    vy: Any
    length: Any
    """[m]"""
    rate: Any
    """Speed of lengthening [m/s]."""
    per_length: Any
    """[1/m]"""


@ti.func
def chord(now: ti.template(), a, b):
    dx, dy = now.x[a] - now.x[b], now.y[a] - now.y[b]
    vx, vy = now.vx[a] - now.vx[b], now.vy[a] - now.vy[b]
    length = sqrt(dx * dx + dy * dy) + 1e-12  # never divides by 0
    per_length = 1.0 / length
    nx, ny = dx * per_length, dy * per_length
    rate = vx * nx + vy * ny
    return ti.static(Chord(nx, ny, vx, vy, length, rate, per_length))


@ti.func
def delayed_rotation(now: ti.template(), c: ti.template(), cosine, sine, spin, ex, ey, chord_spin):
    """Angle of a strip's end from its chord, and what its damping delay adds to it [rad]."""
    rotation = end_rotation(c.nx, c.ny, cosine, sine, ex, ey)
    return rotation + now.numbers.delay * (spin - chord_spin)


@ti.func
def spring_impulses(group: ti.template(), now: ti.template(), first, part):
    """All springs add their impulses: the shape-memory springs, which come first, and the strips.

    `first` is where the free lengths of the interval's first instant begin; `part` of it has passed.
    """
    for k in range(group.springs):
        s = group.spring_at + k
        a, b = group.ends[2 * s], group.ends[2 * s + 1]
        c = ti.static(chord(now, a, b))
        force = variable(now.damping[s] * c.rate)
        if k < group.active:  # a shape-memory spring: Hooke's law
            free = interpolate(now.free_length, first + k, group.active, part)
            stiff = interpolate(now.spring_rate, first + k, group.active, part)
            force += stiff * (c.length - free)
        else:
            force += strip_tension(c.length, now.rest_length[s], now.stiffness[s], now.buckling[s])
        fx, fy = variable(group.dt * force * c.nx), variable(group.dt * force * c.ny)
        if ti.static(group.clamped):
            if k >= group.active:
                couple = bending_couple(group, now, s, a, b, c)
                fx = fx + couple * c.ny
                fy = fy - couple * c.nx
        now.impulse_x[a] = now.impulse_x[a] - fx
        now.impulse_y[a] = now.impulse_y[a] - fy
        now.impulse_x[b] = now.impulse_x[b] + fx
        now.impulse_y[b] = now.impulse_y[b] + fy


@ti.func
def bending_couple(group: ti.template(), now: ti.template(), s, a, b, c: ti.template()):
    """A clamped strip bends and turns the hexagons at its ends; returns the couple of forces that balances
    both moments."""
    ex, ey = group.direction[2 * s], group.direction[2 * s + 1]
    turning = (c.nx * c.vy - c.ny * c.vx) * c.per_length
    pa = delayed_rotation(now, c, now.cosine[a], now.sine[a], now.spin[a], ex, ey, turning)
    pb = delayed_rotation(now, c, now.cosine[b], now.sine[b], now.spin[b], ex, ey, turning)
    ma, mb = end_moments(group.dt * now.bending[s], pa, pb)
    now.moment[a] = now.moment[a] - ma
    now.moment[b] = now.moment[b] - mb
    return (ma + mb) * c.per_length

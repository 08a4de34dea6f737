"""Impulses of the springs and strips of a group of printed robots in one step, each with its tangent.

`now` are the values (`GroupArrays`) and `tangent` their derivatives with respect to the lane's parameter.
Names that begin with d_ are such tangents. Without `group.tangents` none of them is compiled.
"""

from typing import Any, NamedTuple

from eldir.engine.built.motion_launch import ONE, LaneVector
from eldir.engine.built.strip import (
    end_moments,
    end_rotation,
    end_rotation_tangent,
    interpolate,
    strip_tension,
    strip_tension_tangent,
)
from eldir.engine.compiler import ti


class Chord(NamedTuple):
    """A spring's chord from its second to its first mass; or the chord's tangent, without `per_length`."""

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
    per_length: Any = None
    """[1/m]"""


@ti.func
def chord(now: ti.template(), a, b):
    dx, dy = now.x[a] - now.x[b], now.y[a] - now.y[b]
    vx, vy = now.vx[a] - now.vx[b], now.vy[a] - now.vy[b]
    length = ti.sqrt(dx * dx + dy * dy) + 1e-12  # never divides by 0
    per_length = ONE / length
    nx, ny = dx * per_length, dy * per_length
    rate = vx * nx + vy * ny
    return ti.static(Chord(nx, ny, vx, vy, length, rate, per_length))


@ti.func
def chord_tangent(tangent: ti.template(), a, b, c: ti.template()):
    d_dx, d_dy = tangent.x[a] - tangent.x[b], tangent.y[a] - tangent.y[b]
    d_vx, d_vy = tangent.vx[a] - tangent.vx[b], tangent.vy[a] - tangent.vy[b]
    d_length = c.nx * d_dx + c.ny * d_dy
    d_nx = (d_dx - c.nx * d_length) * c.per_length
    d_ny = (d_dy - c.ny * d_length) * c.per_length
    d_rate = d_vx * c.nx + c.vx * d_nx + d_vy * c.ny + c.vy * d_ny
    return ti.static(Chord(d_nx, d_ny, d_vx, d_vy, d_length, d_rate))


@ti.func
def chord_spin(c: ti.template()):
    """Angular velocity of the chord [rad/s]."""
    return (c.nx * c.vy - c.ny * c.vx) * c.per_length


@ti.func
def chord_spin_tangent(c: ti.template(), dc: ti.template(), chord_spin):
    return (dc.nx * c.vy + c.nx * dc.vy - dc.ny * c.vx - c.ny * dc.vx - chord_spin * dc.length) * c.per_length


@ti.func
def delayed_rotation(now: ti.template(), c: ti.template(), cosine, sine, spin, ex, ey, chord_spin):
    """Angle of a strip's end from its chord, and what its damping delay adds to it [rad]."""
    rotation = end_rotation(c.nx, c.ny, cosine, sine, ex, ey)
    return rotation + now.delay * (spin - chord_spin)


@ti.func
def delayed_rotation_tangent(
    now: ti.template(), tangent: ti.template(), d_rotation, spin, d_spin, chord_spin, d_chord_spin
):
    """`d_rotation` is the tangent without the delay."""
    return d_rotation + tangent.delay * (spin - chord_spin) + now.delay * (d_spin - d_chord_spin)


@ti.func
def add_impulse(now: ti.template(), a, b, fx, fy):
    """Pulls the two masses of a spring together."""
    now.impulse_x[a] = now.impulse_x[a] - fx
    now.impulse_y[a] = now.impulse_y[a] - fy
    now.impulse_x[b] = now.impulse_x[b] + fx
    now.impulse_y[b] = now.impulse_y[b] + fy


@ti.func
def add_moments(now: ti.template(), a, b, ma, mb):
    now.moment[a] = now.moment[a] - ma
    now.moment[b] = now.moment[b] - mb


@ti.func
def shape_memory_force(
    group: ti.template(), now: ti.template(), tangent: ti.template(), c: ti.template(), dc: ti.template(),
    q, part,
):  # fmt: skip
    """Force of a shape-memory spring by Hooke's law [N], and its tangent."""
    d_force = LaneVector(0.0)
    free = interpolate(now.free_length, q, group.active, part)
    stiff = interpolate(now.spring_rate, q, group.active, part)
    force = stiff * (c.length - free)
    if ti.static(group.tangents):
        d_free = interpolate(tangent.free_length, q, group.active, part)
        d_stiff = interpolate(tangent.spring_rate, q, group.active, part)
        d_force = d_stiff * (c.length - free) + stiff * (dc.length - d_free)
    return force, d_force


@ti.func
def strip_force(
    group: ti.template(), now: ti.template(), tangent: ti.template(), c: ti.template(), dc: ti.template(), s
):
    """Force of a strip along its chord [N], and its tangent."""
    d_force = LaneVector(0.0)
    rest, stiff, load = now.rest_length[s], now.stiffness[s], now.buckling[s]
    force = strip_tension(c.length, rest, stiff, load)
    if ti.static(group.tangents):
        d_force = strip_tension_tangent(
            c.length, rest, stiff, load,
            dc.length, tangent.rest_length[s], tangent.stiffness[s], tangent.buckling[s],
        )  # fmt: skip
    return force, d_force


@ti.func
def spring_impulses(group: ti.template(), now: ti.template(), tangent: ti.template(), first, part):
    """All springs add their impulses: the shape-memory springs, which come first, and the strips.

    `first` is where the free lengths of the interval's first instant begin; `part` of it has passed.
    """
    for k in range(group.springs):
        s = group.spring_at + k
        a, b = group.ends[2 * s], group.ends[2 * s + 1]
        c = ti.static(chord(now, a, b))
        dc = ti.static(chord_tangent(tangent, a, b, c) if group.tangents else c)
        force, d_force = now.damping[s] * c.rate, LaneVector(0.0)
        if ti.static(group.tangents):
            d_force = tangent.damping[s] * c.rate + now.damping[s] * dc.rate
        if k < group.active:
            added, d_added = shape_memory_force(group, now, tangent, c, dc, first + k, part)
            force += added
            d_force += d_added
        else:
            added, d_added = strip_force(group, now, tangent, c, dc, s)
            force += added
            d_force += d_added
        fx, fy = group.dt * force * c.nx, group.dt * force * c.ny
        d_fx, d_fy = LaneVector(0.0), LaneVector(0.0)
        if ti.static(group.tangents):
            d_fx = group.dt * (d_force * c.nx + force * dc.nx)
            d_fy = group.dt * (d_force * c.ny + force * dc.ny)
        if ti.static(group.clamped):
            if k >= group.active:
                couple, d_couple = bending_couple(group, now, tangent, s, a, b, c, dc)
                fx = fx + couple * c.ny
                fy = fy - couple * c.nx
                if ti.static(group.tangents):
                    d_fx = d_fx + d_couple * c.ny + couple * dc.ny
                    d_fy = d_fy - d_couple * c.nx - couple * dc.nx
        add_impulse(now, a, b, fx, fy)
        if ti.static(group.tangents):
            add_impulse(tangent, a, b, d_fx, d_fy)


@ti.func
def bending_couple(
    group: ti.template(), now: ti.template(), tangent: ti.template(), s, a, b,
    c: ti.template(), dc: ti.template(),
):  # fmt: skip
    """A clamped strip bends and turns the hexagons at its ends; returns the couple of forces that balances
    both moments, and its tangent."""
    ex, ey = group.direction[2 * s], group.direction[2 * s + 1]
    ca, sa, ra = now.cosine[a], now.sine[a], now.spin[a]
    cb, sb, rb = now.cosine[b], now.sine[b], now.spin[b]
    turning = chord_spin(c)
    pa = delayed_rotation(now, c, ca, sa, ra, ex, ey, turning)
    pb = delayed_rotation(now, c, cb, sb, rb, ex, ey, turning)
    ma, mb = end_moments(group.dt * now.bending[s], pa, pb)
    add_moments(now, a, b, ma, mb)
    couple = (ma + mb) * c.per_length
    d_couple = LaneVector(0.0)
    if ti.static(group.tangents):
        d_ca, d_sa, d_ra = tangent.cosine[a], tangent.sine[a], tangent.spin[a]
        d_cb, d_sb, d_rb = tangent.cosine[b], tangent.sine[b], tangent.spin[b]
        d_turning = chord_spin_tangent(c, dc, turning)
        d_pa = end_rotation_tangent(c.nx, c.ny, ca, sa, dc.nx, dc.ny, d_ca, d_sa)
        d_pb = end_rotation_tangent(c.nx, c.ny, cb, sb, dc.nx, dc.ny, d_cb, d_sb)
        d_pa = delayed_rotation_tangent(now, tangent, d_pa, ra, d_ra, turning, d_turning)
        d_pb = delayed_rotation_tangent(now, tangent, d_pb, rb, d_rb, turning, d_turning)
        d_ma, d_mb = end_moments(group.dt * now.bending[s], d_pa, d_pb)
        by_bending_a, by_bending_b = end_moments(group.dt * tangent.bending[s], pa, pb)
        d_ma, d_mb = d_ma + by_bending_a, d_mb + by_bending_b
        add_moments(tangent, a, b, d_ma, d_mb)
        d_couple = (d_ma + d_mb - couple * dc.length) * c.per_length
    return couple, d_couple

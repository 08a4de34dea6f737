"""Hubs of a printed robot: rigid hexagons whose sockets hold the strips, and that stand on their corners.

For robots with `eldir.parameters.printed.BuiltParameters.with_hubs`; those with pins or clamped strips are
computed by `impulses` and `integration`, which are shorter. `now` are the group's values (`GroupArrays`),
which are dual numbers where tangents are computed.

Angles between a hub and a strip come from five terms of the arc sine's series, without a division: up to 30
degrees they are right to 1e-5, at 45 degrees to 6e-4. Beyond a right angle they stay constant.
"""

from typing import Any, NamedTuple

from eldir.engine.built.dual import (
    callable_in_kernels,
    maximum,
    minimum,
    negative,
    polynomial,
    select,
    sqrt,
    value_of,
    variable,
    zero_like,
)
from eldir.engine.built.integration import turn_hexagon
from eldir.engine.built.motion_launch import ONE, ZERO, LaneVector
from eldir.engine.built.strip import bending_angle, end_moments, interpolate, strip_tension
from eldir.engine.built.terrain import find_lines, is_near, magnitude, min_gap
from eldir.engine.compiler import ti

_COS60, _SIN60 = 0.5, 0.75**0.5
_ARC_SINE = (1.0, 1 / 6, 3 / 40, 15 / 336, 105 / 3456)


class Hinges(NamedTuple):
    """A spring between its hinges."""

    ax: Any
    """Unit vector in the first hub from its hinge to that hub's centre; at rest, along the spring."""
    ay: Any
    bx: Any
    """The same vector in the second hub."""
    by: Any
    nx: Any
    """Unit vector from the second to the first hinge."""
    ny: Any
    length: Any
    """[m]"""
    rate: Any
    """Speed of lengthening [m/s]."""
    per_length: Any
    """[1/m]"""
    turning: Any
    """Angular velocity of the spring [rad/s]."""


@ti.func
def clamp(value, limit):
    return maximum(minimum(value, limit), negative(limit))


@ti.func
def hinges(group: ti.template(), now: ti.template(), s, a, b):
    """Position and motion of the hinges of spring s between hubs a and b."""
    ex, ey = group.direction[2 * s], group.direction[2 * s + 1]
    ax, ay = now.cosine[a] * ex - now.sine[a] * ey, now.sine[a] * ex + now.cosine[a] * ey
    bx, by = now.cosine[b] * ex - now.sine[b] * ey, now.sine[b] * ex + now.cosine[b] * ey
    dx = now.x[a] - now.x[b] - now.parameters.socket * (ax + bx)
    dy = now.y[a] - now.y[b] - now.parameters.socket * (ay + by)
    ux = now.vx[a] - now.vx[b] + now.parameters.socket * (now.spin[a] * ay + now.spin[b] * by)
    uy = now.vy[a] - now.vy[b] - now.parameters.socket * (now.spin[a] * ax + now.spin[b] * bx)
    length = sqrt(dx * dx + dy * dy) + 1e-12  # never divides by 0
    per_length = 1.0 / length
    nx, ny = dx * per_length, dy * per_length
    rate, turning = ux * nx + uy * ny, (nx * uy - ny * ux) * per_length
    return ti.static(Hinges(ax, ay, bx, by, nx, ny, length, rate, per_length, turning))


@ti.func
def angle_between(nx, ny, tx, ty):
    """Angle from unit vector n to t; at most a right angle."""
    sine, cosine = nx * ty - ny * tx, nx * tx + ny * ty
    clipped = select(cosine > ZERO, sine, select(sine < ZERO, ZERO - ONE, ONE))
    return clipped * polynomial(clipped * clipped, _ARC_SINE)


@ti.func
def socket_friction(group: ti.template(), now: ti.template(), at, rotation, delayed_rotation):
    """Angular impulse of a socket's friction on its hub: an elastic bristle, dragged along when it slips
    (Dahl's model of friction)."""
    bristle = now.bristle[at]
    strain = clamp(rotation - bristle, now.numbers.slip_angle)
    now.bristle[at] = rotation - strain
    return (
        group.dt
        * now.parameters.socket_friction
        / now.numbers.slip_angle
        * clamp(delayed_rotation - now.bristle[at], now.numbers.slip_angle)
    )


@ti.func
def hub_impulses(group: ti.template(), now: ti.template(), first, part):
    """All springs add their impulses, as `impulses.spring_impulses` does."""
    for k in range(group.springs):
        s = group.spring_at + k
        a, b = group.ends[2 * s], group.ends[2 * s + 1]
        h = ti.static(hinges(group, now, s, a, b))
        force = variable(now.damping[s] * h.rate)
        ma, mb = zero_like(h.rate), zero_like(h.rate)
        if k < group.active:  # a shape-memory spring: Hooke's law, its ends turn freely
            free = interpolate(now.free_length, first + k, group.active, part) - 2.0 * now.parameters.socket
            stiff = interpolate(now.spring_rate, first + k, group.active, part)
            force += stiff * (h.length - free)
        else:
            rest = now.rest_length[s] - 2.0 * now.parameters.socket
            force += strip_tension(h.length, rest, now.stiffness[s], now.buckling[s])
            ma, mb = strip_moments(group, now, s, a, b, h)
        couple = (ma + mb) * h.per_length
        fx = group.dt * force * h.nx + couple * h.ny
        fy = group.dt * force * h.ny - couple * h.nx
        now.impulse_x[a] = now.impulse_x[a] - fx
        now.impulse_y[a] = now.impulse_y[a] - fy
        now.impulse_x[b] = now.impulse_x[b] + fx
        now.impulse_y[b] = now.impulse_y[b] + fy
        now.moment[a] = now.moment[a] + (now.parameters.socket * (h.ax * fy - h.ay * fx) - ma)
        now.moment[b] = now.moment[b] + (now.parameters.socket * (h.bx * fy - h.by * fx) - mb)


@ti.func
def strip_moments(group: ti.template(), now: ti.template(), s, a, b, h: ti.template()):
    """A strip turns in its sockets with friction, and bends beyond their play: the angular impulses that it
    takes from its hubs."""
    pa, pb = (
        angle_between(h.nx, h.ny, h.ax, h.ay),
        angle_between(h.nx, h.ny, h.bx, h.by),
    )
    da = pa + now.numbers.delay * (now.spin[a] - h.turning)
    db = pb + now.numbers.delay * (now.spin[b] - h.turning)
    play = now.parameters.socket_turn
    ea, eb = da - clamp(da, play), db - clamp(db, play)
    qa, qb = bending_angle(da, eb, play), bending_angle(db, ea, play)
    ma, mb = end_moments(group.dt * now.bending[s], qa, qb)
    fa, fb = socket_friction(group, now, 2 * s, pa, da), socket_friction(group, now, 2 * s + 1, pb, db)
    return ma + fa, mb + fb


@ti.func
def lowest_corner(cosine, sine):
    """Cosine and sine of the hub's rotation from the nearest pose in which a corner points down."""
    left_c, left_s = _COS60 * cosine - _SIN60 * sine, _COS60 * sine + _SIN60 * cosine
    right_c, right_s = _COS60 * cosine + _SIN60 * sine, _COS60 * sine - _SIN60 * cosine
    c, s = select(left_c > cosine, left_c, cosine), select(left_c > cosine, left_s, sine)
    return maximum(right_c, c), select(right_c > c, right_s, s)


@ti.func
def move_hubs(group: ti.template(), now: ti.template(), going):
    """Semi-implicit Euler with drag, gravity, impulses, and the ground under the lowest corner."""
    for i in range(group.masses):
        w, wi = now.inverse_mass[i], now.inverse_inertia[i]
        before_x, before_y, before = now.vx[i], now.vy[i], now.spin[i]
        ux = now.numbers.decay * before_x + now.impulse_x[i] * w + now.numbers.gravity_tangent_dt
        uy = now.numbers.decay * before_y + now.impulse_y[i] * w + now.numbers.gravity_normal_dt
        turning = now.numbers.decay * before + now.moment[i] * wi
        forward = now.friction[i]
        backward = forward * now.parameters.backward_friction
        vx, vy, spin = hub_contact(group, now, i, ux, uy, turning, w, wi, forward, backward)
        now.x[i] = now.x[i] + select(going, group.dt * vx, ZERO)
        now.y[i] = now.y[i] + select(going, group.dt * vy, ZERO)
        now.vx[i] = select(going, vx, before_x)
        now.vy[i] = select(going, vy, before_y)
        turn_hexagon(group, now, i, select(going, spin, before), going)
        now.impulse_x[i] = ZERO
        now.impulse_y[i] = ZERO
        now.moment[i] = ZERO


@callable_in_kernels
def hub_contact(group, now, i, ux, uy, turning, w, wi, forward, backward):
    """Velocity and spin of a hub after the impulses of the ground."""
    contact = hub_terrain_contact if group.terrain else hub_table_contact
    return contact(group, now, i, ux, uy, turning, w, wi, forward, backward)


@ti.func
def hub_table_contact(group: ti.template(), now: ti.template(), i, ux, uy, turning, w, wi, forward, backward):
    c, s = lowest_corner(now.cosine[i], now.sine[i])
    rx, ry = now.parameters.corner * s, negative(now.parameters.corner * c)
    height = now.y[i] + now.parameters.corner * (1.0 - c)
    tangential, normal = ux - turning * ry, uy + turning * rx
    p, q = corner_contact(group, height, tangential, normal, rx, ry, w, wi, forward, backward)
    return ux + w * p, uy + w * q, turning + wi * (rx * q - ry * p)


@ti.func
def hub_terrain_contact(
    group: ti.template(), now: ti.template(), i, ux, uy, turning, w, wi, forward, backward
):
    """The impulses on each lower corner, first of the segment that is under it, then of the one that will be
    under it after the step."""
    vx, vy, spin = variable(ux), variable(uy), variable(turning)
    x, y, corner = now.x[i], now.y[i], now.parameters.corner
    radius = value_of(corner)
    ground = ti.static(group.ground)
    speed = magnitude(value_of(ux)) + magnitude(value_of(uy)) + radius * magnitude(value_of(turning))
    if is_near(ground, value_of(x), value_of(y), group.dt * speed):
        for later in range(2):
            seconds = LaneVector(ti.cast(later, ti.f64)) * group.dt
            turn_c, turn_s = LaneVector(ground.first_cosine), LaneVector(ground.first_sine)
            for _ in range(ground.corners):
                c = turn_c * now.cosine[i] - turn_s * now.sine[i]
                s = turn_s * now.cosine[i] + turn_c * now.sine[i]
                rx, ry = corner * s, negative(corner * c)
                at = value_of(x) + value_of(rx) + seconds * (value_of(vx) - value_of(spin) * value_of(ry))
                line = ti.static(find_lines(ground, at))
                height = (y + corner + ry - line.slope * (x + rx) - line.intercept) * line.ny
                along, away = rx * line.ny - ry * line.nx, rx * line.nx + ry * line.ny
                tangential = vx * line.ny - vy * line.nx - spin * away
                normal = vx * line.nx + vy * line.ny + spin * along
                gap = maximum(height, min_gap(group.dt))
                p, q = corner_contact(group, gap, tangential, normal, along, away, w, wi, forward, backward)
                vx = vx + w * (p * line.ny + q * line.nx)
                vy = vy + w * (q * line.ny - p * line.nx)
                spin = spin + wi * (along * q - away * p)
                turn_c, turn_s = turn_next(ground, turn_c, turn_s)
    return vx, vy, spin


@ti.func
def turn_next(ground: ti.template(), c, s):
    """A rotation by 60 degrees more. The compilers keep constants with 32 bits, arguments with 64."""
    cosine, sine = LaneVector(ground.next_cosine), LaneVector(ground.next_sine)
    return cosine * c - sine * s, cosine * s + sine * c


@ti.func
def corner_contact(group: ti.template(), height, tangential, normal, rx, ry, w, wi, forward, backward):
    """Impulses (along the ground, away) on a corner at (rx, ry) from its hub's centre, `height` above it,
    with these speeds: they end its fall within the step and stop it, or slow it as far as Coulomb friction
    does, with its coefficients for sliding forward and backward. w and wi are the hub's inverse mass and
    moment of inertia."""
    needed = negative(height / group.dt) - normal
    a, b, c = w + wi * ry * ry, negative(wi * rx * ry), w + wi * rx * rx
    per_determinant = 1.0 / (a * c - b * b)
    stick = negative((c * tangential + b * needed) * per_determinant)
    push = (a * needed + b * tangential) * per_determinant
    coefficient = select(stick < ZERO, negative(forward), backward)
    slips = maximum(stick, negative(stick)) > select(stick < ZERO, forward, backward) * push
    pushed = select(slips, needed / (c + b * coefficient), push)
    held = select(slips, coefficient * pushed, stick)
    return select(needed > ZERO, held, ZERO), select(needed > ZERO, pushed, ZERO)

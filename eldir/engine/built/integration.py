"""Motion of the masses and hexagons of a group of printed robots in one step.

The ground is the table y = 0 or a terrain (`terrain`), with dry friction (Coulomb) that is not regularised.
`now` are the group's values (`GroupArrays`), which are dual numbers where tangents are computed.
"""

from eldir.engine.built.dual import (
    callable_in_kernels,
    maximum,
    minimum,
    negative,
    select,
    value_of,
    variable,
)
from eldir.engine.built.motion_launch import ONE, ZERO
from eldir.engine.built.terrain import any_positive, find_lines, is_near, magnitude, min_gap
from eldir.engine.compiler import ti


@ti.func
def coulomb_impulse(height, tangential, normal, forward, backward, dt):
    """What the ground takes from a mass's speed along it, and adds to that away from it: it ends the fall
    within the step, and slows the mass by at most its coefficient times that, `forward` or `backward` as it
    slides."""
    normal_impulse = maximum(negative(height / dt) - normal, ZERO)
    limited = minimum(tangential, forward * normal_impulse)
    return maximum(limited, negative(backward * normal_impulse)), normal_impulse


@callable_in_kernels
def mass_contact(group, now, i, wx, wy, forward, backward):
    """Velocity of a mass after the impulses of the ground."""
    return (terrain_contact if group.terrain else table_contact)(group, now, i, wx, wy, forward, backward)


@ti.func
def table_contact(group: ti.template(), now: ti.template(), i, wx, wy, forward, backward):
    taken, added = coulomb_impulse(now.y[i], wx, wy, forward, backward, group.dt)
    return wx - taken, wy + added


@ti.func
def terrain_contact(group: ti.template(), now: ti.template(), i, wx, wy, forward, backward):
    """The impulses of the segment under the mass and, where it crosses a corner of the ground in this step,
    of the segment to which it comes."""
    vx, vy = variable(wx), variable(wy)
    x, y, dt = now.x[i], now.y[i], group.dt
    at = value_of(x)
    if is_near(group.ground, at, value_of(y), dt * (magnitude(value_of(wx)) + magnitude(value_of(wy)))):
        under = ti.static(find_lines(group.ground, at))
        vx, vy = segment_contact(under, x, y, vx, vy, forward, backward, dt)
        ahead = at + dt * value_of(vx)
        outside = ti.select(ahead >= under.start, ti.select(ahead < under.end, ZERO, ONE), ONE)
        if any_positive(outside):
            onto = ti.static(find_lines(group.ground, ahead))
            ax, ay = segment_contact(onto, x, y, vx, vy, forward, backward, dt)
            vx, vy = select(outside > ZERO, ax, vx), select(outside > ZERO, ay, vy)
    return vx, vy


@ti.func
def segment_contact(line: ti.template(), x, y, vx, vy, forward, backward, dt):
    """Velocity of a mass after the impulse of one line."""
    gap = maximum((y - line.slope * x - line.intercept) * line.ny, min_gap(dt))
    tangential, normal = vx * line.ny - vy * line.nx, vx * line.nx + vy * line.ny
    taken, added = coulomb_impulse(gap, tangential, normal, forward, backward, dt)
    return vx + added * line.nx - taken * line.ny, vy + added * line.ny + taken * line.nx


@ti.func
def move_masses(group: ti.template(), now: ti.template(), going):
    """Semi-implicit Euler with drag, gravity, impulses and the ground. Robots not `going` wait."""
    for i in range(group.masses):
        w, before_x, before_y = now.inverse_mass[i], now.vx[i], now.vy[i]
        wx = now.numbers.decay * before_x + now.impulse_x[i] * w + now.numbers.gravity_tangent_dt
        wy = now.numbers.decay * before_y + now.impulse_y[i] * w + now.numbers.gravity_normal_dt
        forward = now.friction[i]
        backward = forward * now.parameters.backward_friction
        vx, vy = mass_contact(group, now, i, wx, wy, forward, backward)
        now.x[i] = now.x[i] + select(going, group.dt * vx, ZERO)
        now.y[i] = now.y[i] + select(going, group.dt * vy, ZERO)
        now.vx[i] = select(going, vx, before_x)
        now.vy[i] = select(going, vy, before_y)
        now.impulse_x[i] = ZERO
        now.impulse_y[i] = ZERO


@ti.func
def turn_hexagons(group: ti.template(), now: ti.template(), going):
    for i in range(group.masses):
        before = now.spin[i]
        after = now.numbers.decay * before + now.moment[i] * now.inverse_inertia[i]
        turn_hexagon(group, now, i, select(going, after, before), going)
        now.moment[i] = ZERO


@ti.func
def turn_hexagon(group: ti.template(), now: ti.template(), i, spin, going):
    """Cayley's rotation by dt spin, which keeps cosine^2 + sine^2 = 1."""
    half = select(going, 0.5 * group.dt * spin, ZERO)
    square, double = half * half, half + half
    scale, c0, s0 = 1.0 / (square + ONE), now.cosine[i], now.sine[i]
    now.cosine[i] = ((1.0 - square) * c0 - double * s0) * scale
    now.sine[i] = ((1.0 - square) * s0 + double * c0) * scale
    now.spin[i] = spin
